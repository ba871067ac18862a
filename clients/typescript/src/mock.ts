// A take in the place of a stage: plays messages from a file to a client, at the distances in time at which they came, for programs that are tested
// without the daemon.
//
// In: messages as lines of JSON, as `posed export take.mcap --to jsonl` writes them. Out: what behaves like the websocket of a stage, for `Options.socket`. It streams,
// and refuses every request but those of subscriptions.

import { OPEN } from "./client.js";
import type { Feed, Hello, HelloSensor, ServerMessage, Topic } from "./posed.v1.js";

export interface MockOptions {
  /** How much faster than it happened; `Infinity`: as fast as it can. */
  speed?: number;
  /** Called after the last message. */
  onEnd?: () => void;
}

type Subscribe = Extract<Feed, { type: "subscribe" }>;
type Played = Exclude<ServerMessage, { type: "ok" | "error" }>;

/** So many messages in a row at the highest speed, before others have their turn. */
const BURST = 64;
const OPEN_MS = 0;

/**
 * The socket of a client without a stage: `new Client("ws://mock", { socket: mockStage(text) }).connect()`. It begins at the first message once the client has
 * subscribed, and anew with every connection.
 */
export function mockStage(lines: string, options: MockOptions = {}): (address: string, protocol: string) => WebSocket {
  const messages = lines.split("\n").flatMap((line, at) => (line.trim() === "" ? [] : [read(line, at + 1)]));
  const hello = messages.find((message): message is Hello & Played => message.type === "hello") ?? greeting(messages);
  return () => new MockSocket({ ...hello, last_event_id: 0 }, messages, options) as unknown as WebSocket;
}

function read(line: string, number: number): Played {
  let message: unknown;
  try {
    message = JSON.parse(line);
  } catch {
    message = null;
  }
  if (typeof message === "object" && message !== null && "type" in message) return message as Played;
  throw new Error(`line ${number} is no message`);
}

/** Exports have none. */
function greeting(messages: Played[]): Hello & Played {
  const topics = [...new Set(messages.map(({ type }) => type as Topic))];
  const frame = messages.find((message) => message.type === "sensors");
  const sensor = ({ name, device, position_m }: NonNullable<typeof frame>["sensors"][number]): HelloSensor => ({ name, device: device ?? "", magnetic: position_m != null });
  return {
    type: "hello", version: "mock", stage: "mock", epoch_utc: "1970-01-01T00:00:00.000000000Z", topics,
    sensors: frame?.sensors.map(sensor) ?? [], bodies: [], skeleton: null, height_m: null,
    transmitter: { position_m: [0, 0, 0], orientation_wxyz: [1, 0, 0, 0] }, transmitter_given: false, role: "watch", last_event_id: 0,
  };
}

class MockSocket {
  onopen: (() => void) | null = null;
  onmessage: ((event: { data: string }) => void) | null = null;
  onclose: ((event: { code: number; reason: string }) => void) | null = null;
  onerror: (() => void) | null = null;
  /** As a `WebSocket` has it: 0 connecting, 1 open, 3 closed. */
  readyState = 0;
  private plays = false;
  private readonly wanted = new Map<string, { choice: Subscribe; seq: number; due_s: number }>();

  constructor(
    private readonly hello: Hello & Played,
    private readonly messages: Played[],
    private readonly options: MockOptions,
  ) {
    setTimeout(() => {
      if (this.readyState > 0) return;
      this.readyState = OPEN;
      this.onopen?.();
      this.say(this.hello);
    }, OPEN_MS);
  }

  send(text: string): void {
    const request = JSON.parse(text) as Feed;
    if (request.type === "subscribe") {
      for (const topic of request.topics) this.wanted.set(topic, { choice: request, seq: 0, due_s: -Infinity });
    } else if (request.type === "unsubscribe") {
      for (const topic of request.topics) this.wanted.delete(topic);
    } else if (request.type !== "resume") {
      const { type } = request as { type: string };
      this.say({ type: "error", id: (request as Feed).id, code: "mock", message: `a take that is played from a file only streams: it does no ${type}` });
      return;
    }
    this.say({ type: "ok", id: request.id });
    if (request.type !== "subscribe" || this.plays) return;
    this.plays = true;
    void this.play();
  }

  close(): void {
    this.readyState = 3;
  }

  private say(message: ServerMessage): void {
    if (this.readyState === OPEN) this.onmessage?.({ data: JSON.stringify(message) });
  }

  private async play(): Promise<void> {
    const { speed = 1 } = this.options;
    const [began_ms, first_s] = [performance.now(), this.messages.find((message) => "t_s" in message)?.t_s ?? 0];
    let sent = 0;
    for (const message of this.messages) {
      if (!("t_s" in message)) continue;
      const wait_ms = began_ms + (1000 * (message.t_s - first_s)) / speed - performance.now();
      if (wait_ms > 0 || sent++ % BURST === 0) await new Promise((resolve) => setTimeout(resolve, Math.max(wait_ms, 0)));
      if (this.readyState !== OPEN) return;
      const shown = this.shown(message);
      if (shown) this.say(shown);
    }
    this.options.onEnd?.();
  }

  /** The message as the client wants it; null where it is not wanted, or too soon for another. */
  private shown(message: Played & { t_s: number }): ServerMessage | null {
    const wanted = this.wanted.get(message.type);
    if (!wanted) return null;
    const { max_rate_hz, sensors } = wanted.choice;
    if (!("event_id" in message) && max_rate_hz != null) {
      if (message.t_s < wanted.due_s) return null;
      const next_s = wanted.due_s + 1 / max_rate_hz;
      wanted.due_s = next_s > message.t_s ? next_s : message.t_s + 1 / max_rate_hz;
    }
    const shown = { ...message, seq: wanted.seq++, dropped: 0 } as Played;
    if (shown.type === "sensors" && sensors) shown.sensors = sensors.flatMap((name) => shown.sensors.find((sensor) => sensor.name === name) ?? []);
    return shown;
  }
}
