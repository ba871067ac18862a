// The websocket: connects, asks for every topic the stage has, reconnects by itself, and asks for what was missed.

import type { Answers, Call, Feed, Field, Hello, ServerMessage, Topic } from "./protocol";
import { DRAWN_HZ } from "./pace";

const RETRY_MS = [500, 1000, 2000, 5000];
/** What the views show of each sensor. */
const FIELDS: Field[] = ["device", "position_m", "orientation_wxyz", "sigma_m", "measured", "fault", "change"];
/** The code with which the daemon closes connections where its stage has changed. */
const STAGE_CHANGED = 1012;
const TOKEN_KEY = "posed.token";

export type LinkState = "connecting" | "open" | "lost" | "unauthorised";

type WithoutId<T> = T extends { id: unknown } ? Omit<T, "id"> : never;
export type Request = WithoutId<Call> | WithoutId<Feed>;
/** What a request of this kind is answered with. */
type AnswerTo<R extends Request> = R["type"] extends keyof Answers ? Answers[R["type"]] : undefined;

/** What a request was refused with: a code for programs, a sentence for people. */
export class Refused extends Error {
  constructor(readonly code: string, sentence: string) {
    super(sentence);
  }
}

/** The websocket beside the page: a hub serves the page of each stage below its name. */
export function websocketOf(page: Pick<Location, "href" | "protocol">): string {
  const address = new URL("ws", page.href);
  address.protocol = page.protocol === "https:" ? "wss:" : "ws:";
  address.search = "";
  address.hash = "";
  return address.href;
}

/**
 * The token of this tab. One in the page's address (`?token=` or `#token=`) is kept for the tab and taken out of the address, so
 * that neither the history nor a copied link has it.
 */
export function tokenOf(page: Location): string | null {
  const address = new URL(page.href);
  const hash = new URLSearchParams(address.hash.slice(1));
  const given = address.searchParams.get("token") ?? hash.get("token");
  if (given !== null) {
    sessionStorage.setItem(TOKEN_KEY, given);
    address.searchParams.delete("token");
    if (hash.has("token")) address.hash = "";
    history.replaceState(history.state, "", address);
  }
  return sessionStorage.getItem(TOKEN_KEY);
}

const ignore = () => undefined;

export class Link {
  private socket: WebSocket | null = null;
  private attempts = 0;
  private nextId = 1;
  private lastEvent = 0;
  private rate_hz = DRAWN_HZ;
  private states: Topic[] = [];
  private waiting = new Map<number, { resolve: (result: unknown) => void; reject: (error: Error) => void }>();

  private closes = false;

  /** `address`: another websocket than the one beside the page; `feeds`: whether it wants what the stage publishes, and not only answers. */
  constructor(
    private readonly onMessage: (message: ServerMessage) => void,
    private readonly onState: (state: LinkState, why: string) => void,
    private readonly address = () => websocketOf(location),
    private readonly feeds = true,
  ) {}

  connect(): void {
    this.onState("connecting", "");
    const token = tokenOf(location);
    const query = token === null ? "" : `?token=${encodeURIComponent(token)}`;
    const socket = new WebSocket(this.address() + query, "posed.v1");
    this.socket = socket;
    let greeted = false;
    socket.onmessage = ({ data }) => {
      const message = JSON.parse(data) as ServerMessage;
      if (message.type === "hello") {
        greeted = true;
        this.attempts = 0;
        this.greet(message);
      } else if (message.type === "ok" || message.type === "error") {
        this.answer(message);
        return;
      } else if ("event_id" in message) {
        this.lastEvent = Math.max(this.lastEvent, message.event_id);
      }
      this.onMessage(message);
    };
    socket.onclose = ({ code, reason }) => {
      this.waiting.forEach(({ reject }) => reject(new Refused("lost", "the connection broke before the answer")));
      this.waiting.clear();
      // Another stage follows at the same address, and waits already.
      if (code === STAGE_CHANGED) {
        this.onState("connecting", reason);
        setTimeout(() => this.connect(), 50);
        return;
      }
      void this.closed(greeted, reason || `connection lost (${code})`);
    };
  }

  /** Ends the connection for good. */
  close(): void {
    this.closes = true;
    this.socket?.close();
  }

  /** The token is kept for this tab and tried at once. */
  useToken(token: string): void {
    sessionStorage.setItem(TOKEN_KEY, token);
    this.connect();
  }

  /** So many states a second are enough. */
  useRate(rate_hz: number): void {
    this.rate_hz = rate_hz;
    if (this.states.length === 0) return;
    this.request({ type: "subscribe", topics: this.states, max_rate_hz: rate_hz, fields: FIELDS }).catch(ignore);
  }

  /** Asks the daemon, while it connects as soon as it has; the answer's result, or a `Refused`. */
  request<R extends Request>(request: R): Promise<AnswerTo<R>> {
    return new Promise((resolve, reject) => {
      const { socket } = this;
      if (socket?.readyState !== WebSocket.OPEN && socket?.readyState !== WebSocket.CONNECTING) {
        reject(new Refused("lost", "not connected"));
        return;
      }
      const id = this.nextId++;
      this.waiting.set(id, { resolve: resolve as (result: unknown) => void, reject });
      const send = (): void => socket.send(JSON.stringify({ ...request, id }));
      if (socket.readyState === WebSocket.OPEN) send();
      else socket.addEventListener("open", send, { once: true });
    });
  }

  private greet(hello: Hello): void {
    this.onState("open", "");
    if (!this.feeds) return;
    this.states = hello.topics.filter((topic) => topic === "sensors" || topic === "truth" || topic === "body");
    const rest = hello.topics.filter((topic) => !this.states.includes(topic));
    this.request({ type: "subscribe", topics: rest }).catch(ignore);
    this.useRate(this.rate_hz);
    // A daemon that was started anew counts from one again.
    if (this.lastEvent > hello.last_event_id) this.lastEvent = 0;
    if (this.lastEvent > 0) this.request({ type: "resume", after: this.lastEvent }).catch(ignore);
    this.lastEvent = Math.max(this.lastEvent, hello.last_event_id);
  }

  private answer(message: Extract<ServerMessage, { type: "ok" | "error" }>): void {
    const waiting = this.waiting.get(Number(message.id));
    this.waiting.delete(Number(message.id));
    if (message.type === "ok") waiting?.resolve(message.result);
    else waiting?.reject(new Refused(message.code, message.message));
  }

  private async closed(greeted: boolean, why: string): Promise<void> {
    if (this.closes) return;
    // A browser does not say why a websocket was refused; the daemon reports it over HTTP.
    if (!greeted && (await isUnauthorised())) {
      this.onState("unauthorised", "");
      return;
    }
    const wait = RETRY_MS[Math.min(this.attempts++, RETRY_MS.length - 1)] ?? 5000;
    this.onState("lost", why);
    setTimeout(() => this.connect(), wait);
  }
}

async function isUnauthorised(): Promise<boolean> {
  const token = tokenOf(location);
  const headers = token === null ? undefined : { authorization: `Bearer ${token}` };
  try {
    return (await fetch("metrics", { headers, cache: "no-store" })).status === 401;
  } catch {
    return false;
  }
}
