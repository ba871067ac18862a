// Says when a sensor fails and when it is back: `alarm(new Client("http://127.0.0.1:8787/").connect(), console.log)`.

import type { Client } from "../../clients/typescript/src/index.js";

/** Calls `say` with a sentence at each change; until the client is closed. */
export function alarm(client: Client, say: (sentence: string) => void): void {
  const failing = new Map<string, string>();
  client.on("faults", (fault) => {
    if (fault.event !== "fault") return;
    if (fault.active) failing.set(fault.sensor, fault.cause);
    else failing.delete(fault.sensor);
    const others = failing.size > 0 ? ` (failing: ${[...failing.keys()].sort().join(", ")})` : "";
    say(fault.active ? `\u0007${fault.sensor} fails: ${fault.cause}${others}` : `${fault.sensor} is back${others}`);
  });
  client.subscribe({ topics: ["faults"] });
}
