// The websocket to the stage: says who this phone is, sends what it measures in blocks, and connects again.

import { websocketOf } from "../../../clients/typescript/src/client";
import type { Quat, Vec3 } from "./vectors";

/** What the stage thinks of this phone. */
export type Thought = {
  name: string;
  state: "found" | "waiting" | "streaming";
  sensor?: string;
  segment?: string | null;
  rate_hz?: number | null;
  samples?: number;
  lost?: number;
  problems?: string[];
};
/** `replaced`: another page has the same id; `refused`: the token does not serve. */
export type LinkState = "idle" | "connecting" | "open" | "lost" | "replaced" | "refused";
type Said = { ok?: 1; stage?: Thought; blink?: boolean; err?: string; why?: string };

const RETRY_MS = [300, 1000, 2000, 5000];
/** Samples of a block; one that waits longer goes alone, ms. */
const [BLOCK, LATEST_MS] = [4, 90];
/** What a slow network has not taken yet; more is not added to it, bytes. */
const BEHIND = 64_000;
/** The stage begins anew, and waits for this connection. */
const STAGE_CHANGED = 1012;

/** Six digits are more than a phone measures. */
const short = (x: number): number => Math.round(x * 1e6) / 1e6;

export class Link {
  private socket: WebSocket | null = null;
  private greeted = false;
  private wanted = false;
  private attempts = 0;
  private number = 0;
  private rows: number[][] = [];
  private flushing: ReturnType<typeof setTimeout> | undefined;

  constructor(
    private readonly hello: () => object,
    private readonly token: () => string | null,
    private readonly onState: (state: LinkState, why: string) => void,
    private readonly onThought: (thought: Thought) => void,
    private readonly onBlink: () => void,
  ) {}

  open(): void {
    this.wanted = true;
    if (this.socket === null) this.connect();
  }

  close(why: string): void {
    this.wanted = false;
    this.flush();
    if (this.greeted) this.say({ bye: why });
    this.socket?.close(1000, why);
    this.socket = null;
    this.greeted = false;
    this.onState("idle", "");
  }

  /** What the stage should know anew: the name. */
  greet(): void {
    this.say({ imu: 1, ...this.hello() });
  }

  /** Numbered whether it can be sent or not, so that the stage sees what it lacks. */
  send(t_us: number, gyro: Vec3, acceleration: Vec3, q: Quat | null): void {
    const row = [this.number, t_us, ...gyro.map(short), ...acceleration.map(short), ...(q ?? []).map(short)];
    this.number = (this.number + 1) >>> 0;
    if (!this.greeted || (this.socket?.bufferedAmount ?? 0) > BEHIND) return;
    // Rows of one block have as many columns.
    if (this.rows.length > 0 && this.rows[0]!.length !== row.length) this.flush();
    this.rows.push(row);
    if (this.rows.length >= BLOCK) this.flush();
    else this.flushing ??= setTimeout(() => this.flush(), LATEST_MS);
  }

  private flush(): void {
    clearTimeout(this.flushing);
    this.flushing = undefined;
    if (this.rows.length > 0 && this.greeted) this.say({ s: 0, b: this.rows });
    this.rows = [];
  }

  private say(message: object): void {
    // One that closes says so later, and a browser complains of what is sent meanwhile.
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  private connect(): void {
    this.onState("connecting", "");
    const address = this.address();
    const socket = new WebSocket(address, "imu.v1");
    this.socket = socket;
    let why = "";
    socket.onopen = () => this.greet();
    socket.onmessage = ({ data }) => {
      const said = JSON.parse(data as string) as Said;
      if (said.ok === 1) {
        this.greeted = true;
        this.attempts = 0;
        this.onState("open", "");
      } else if (said.stage) this.onThought(said.stage);
      else if (said.blink) this.onBlink();
      else if (said.err !== undefined) why = said.err === "dup_id" ? "dup_id" : said.why ?? said.err;
    };
    socket.onclose = ({ code, reason }) => {
      if (this.socket !== socket) return;
      this.socket = null;
      this.greeted = false;
      this.rows = [];
      if (why === "dup_id") {
        this.wanted = false;
        this.onState("replaced", "");
      } else void this.again(code, why || reason);
    };
  }

  private address(): string {
    const address = new URL(websocketOf(location.href, "imu"));
    const token = this.token();
    if (token !== null) address.searchParams.set("k", token);
    return address.href;
  }

  private async again(code: number, why: string): Promise<void> {
    if (!this.wanted) return;
    // A browser does not say why a websocket was refused; the daemon says it over HTTP.
    if (code === 1006 && (await isRefused(this.address()))) {
      this.wanted = false;
      this.onState("refused", "");
      return;
    }
    this.onState("lost", why || String(code));
    const wait_ms = code === STAGE_CHANGED ? 100 : RETRY_MS[Math.min(this.attempts++, RETRY_MS.length - 1)];
    setTimeout(() => {
      if (this.wanted && this.socket === null) this.connect();
    }, wait_ms);
  }
}

async function isRefused(websocket: string): Promise<boolean> {
  try {
    const { status } = await fetch(websocket.replace(/^ws/, "http"), { cache: "no-store" });
    return status === 401 || status === 403;
  } catch {
    return false;
  }
}
