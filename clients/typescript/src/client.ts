// One connection to a stage: it reconnects by itself, subscribes again, and asks for the events that it missed.
//
// In: an address. Out: typed messages to listeners or as a stream, and an answer or a refusal to every request. It knows nothing of
// pages: it runs wherever there is a WebSocket, or something that behaves like one.

import type { Answers, Call, Feed, Hello, RefusalReason, ServerMessage, Topic } from "./posed.v1.js";

/** Waits before the first, second, ... attempt to connect again, ms; the last one from then on. */
const RETRY_MS = [500, 1000, 2000, 5000];
/** The code with which the daemon closes connections where its stage has changed, and how long until another one waits, ms. */
const STAGE_CHANGED = 1012;
const CHANGES_MS = 50;
/** `WebSocket.OPEN`, which is nowhere where there is no `WebSocket`. */
export const OPEN = 1;

/** `lost`: it tries again by itself. `unauthorised`: it waits for another `connect`, with a token that the stage knows. */
export type LinkState = "connecting" | "open" | "lost" | "unauthorised";

type Unnumbered<T> = T extends { id: unknown } ? Omit<T, "id"> : never;
/** A request, without the number that the client gives it. */
export type Request = Unnumbered<Call> | Unnumbered<Feed>;
/** What a request of this kind is answered with. */
export type AnswerTo<R extends Request> = R["type"] extends keyof Answers ? Answers[R["type"]] : undefined;
/** What is subscribed to, and how. */
export type Choice = Omit<Extract<Feed, { type: "subscribe" }>, "id" | "type">;
/** The messages of one type. */
export type Message<T extends ServerMessage["type"]> = Extract<ServerMessage, { type: T }>;

export interface Options {
  /** The token, or where to look for it at every connection; null: none. */
  token?: string | null | (() => string | null);
  /** Every message but answers, in order. */
  onMessage?: (message: ServerMessage) => void;
  /** What became of the connection, and why. */
  onState?: (state: LinkState, why: string) => void;
  /** Another kind of socket, where there is no `WebSocket` (Node before 22: that of the package `ws`). */
  socket?: (address: string, protocol: string) => WebSocket;
}

/**
 * What a request was refused with: a code for programs, a sentence for people, and where other languages have it which sentence it is and what it
 * names. The code is `lost` where the connection broke first.
 */
export class Refused extends Error {
  constructor(readonly code: string, sentence: string, readonly reason: RefusalReason | null = null, readonly values: Record<string, string> = {}) {
    super(sentence);
  }
}

/** The websocket of a stage, from the address of its page or from its own; `name`: another one that it serves. */
export function websocketOf(page: string, name = "ws"): string {
  const address = new URL(page);
  address.search = "";
  address.hash = "";
  if (address.protocol.startsWith("ws")) return address.href;
  const socket = new URL(name, address);
  socket.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  return socket.href;
}

const ignore = () => undefined;

export class Client {
  /** What the stage said of itself; null while there is no connection. */
  hello: Hello | null = null;
  private socket: WebSocket | null = null;
  private closes = false;
  private attempts = 0;
  private nextId = 1;
  /** The newest event that came or was there before the first greeting; null before that. */
  private lastEvent: number | null = null;
  private choices: Choice[] = [];
  /** Requests made while it connects. */
  private unsent: string[] = [];
  private readonly waiting = new Map<unknown, { resolve: (result: unknown) => void; reject: (error: Error) => void }>();
  private readonly listeners = new Map<string, Set<(message: never) => void>>();
  private readonly streams = new Set<() => void>();

  /** `address`: that of the stage's page or of its websocket, or where to look for it at every connection. `connect` comes after. */
  constructor(
    private readonly address: string | (() => string),
    private readonly options: Options = {},
  ) {}

  /** Connects, and again whenever the connection breaks. */
  connect(): this {
    this.closes = false;
    this.options.onState?.("connecting", "");
    const token = this.token();
    const address = this.websocket() + (token === null ? "" : `?token=${encodeURIComponent(token)}`);
    const open = this.options.socket ?? ((at: string, protocol: string) => new WebSocket(at, protocol));
    const socket = open(address, "posed.v1");
    this.socket = socket;
    socket.onopen = () => {
      for (const text of this.unsent.splice(0)) socket.send(text);
    };
    socket.onmessage = ({ data }) => this.receive(JSON.parse(data as string) as ServerMessage);
    socket.onclose = ({ code, reason }) => {
      if (socket === this.socket) this.lost(code, reason);
    };
    // What a browser says here says nothing; `onclose` follows.
    socket.onerror = ignore;
    return this;
  }

  /** Ends the connection for good; streams end, requests that wait are refused. */
  close(): void {
    this.closes = true;
    const { socket } = this;
    this.socket = null;
    socket?.close();
    this.end("closed");
    for (const wake of this.streams) wake();
  }

  /** Hears every message of a type, until what it returns is called. */
  on<T extends ServerMessage["type"]>(type: T, hear: (message: Message<T>) => void): () => void {
    const heard = this.listeners.get(type) ?? new Set();
    this.listeners.set(type, heard.add(hear));
    return () => heard.delete(hear);
  }

  /** Subscribes, now and after every reconnection, in the place of what was chosen for these topics before. Those that the stage lacks are left out. */
  subscribe(choice: Choice): void {
    const others = this.choices.map((each) => ({ ...each, topics: each.topics.filter((topic) => !choice.topics.includes(topic)) }));
    this.choices = [...others.filter(({ topics }) => topics.length > 0), choice];
    if (this.hello) this.ask(choice, this.hello);
  }

  /** Asks the stage, while it connects as soon as it has. Resolves with the answer's result; rejects with a `Refused`. */
  request<R extends Request>(request: R): Promise<AnswerTo<R>> {
    return new Promise((resolve, reject) => {
      // One that closes takes nothing any more, though `onclose` is still to come.
      if (!this.socket || this.socket.readyState > OPEN) {
        reject(new Refused("lost", "not connected"));
        return;
      }
      const id = this.nextId++;
      this.waiting.set(id, { resolve: resolve as (result: unknown) => void, reject });
      const text = JSON.stringify({ ...request, id });
      if (this.socket.readyState === OPEN) this.socket.send(text);
      else this.unsent.push(text);
    });
  }

  /**
   * The messages of a topic, one after the other: `for await (const frame of client.frames("sensors"))`. Who is slow gets the newest
   * state; events, and what was chosen with `drop: "queue"`, are kept. Ends when the client is closed.
   */
  async *frames<T extends Topic>(topic: T, choice: Omit<Choice, "topics"> = {}): AsyncGenerator<Message<T>, void> {
    const came: Message<T>[] = [];
    let wake = ignore as () => void;
    const off = this.on(topic, (message) => {
      if (choice.drop !== "queue" && !("event_id" in message)) came.length = 0;
      came.push(message);
      wake();
    });
    const ended = () => wake();
    this.streams.add(ended);
    this.subscribe({ topics: [topic], ...choice });
    try {
      while (!this.closes) {
        const next = came.shift();
        if (next) yield next;
        else await new Promise<void>((resolve) => (wake = resolve));
      }
    } finally {
      off();
      this.streams.delete(ended);
    }
  }

  /** A client of a recorded take beside this stage; with `{ type: "replay.speed", speed }` it plays as fast as is wished. */
  take(name: string, options: Options = this.options): Client {
    return new Client(() => new URL(`takes/${encodeURIComponent(name)}/ws`, this.websocket()).href, options);
  }

  /** When a message was measured, by the clock of the stage's computer; null while that is not known. */
  captureTime(t_s: number): Date | null {
    return this.hello && new Date(Date.parse(this.hello.epoch_utc) + 1000 * t_s);
  }

  private websocket(): string {
    return websocketOf(typeof this.address === "string" ? this.address : this.address());
  }

  private token(): string | null {
    const { token } = this.options;
    return (typeof token === "function" ? token() : token) ?? null;
  }

  private ask(choice: Choice, hello: Hello): void {
    const topics = choice.topics.filter((topic) => hello.topics.includes(topic));
    if (topics.length > 0) this.request({ type: "subscribe", ...choice, topics }).catch(ignore);
  }

  private receive(message: ServerMessage): void {
    if (message.type === "ok" || message.type === "error") {
      const waiting = this.waiting.get(message.id);
      this.waiting.delete(message.id);
      if (message.type === "ok") waiting?.resolve(message.result);
      else waiting?.reject(new Refused(message.code, message.message, message.reason, message.values));
      return;
    }
    if ("event_id" in message) this.lastEvent = Math.max(this.lastEvent ?? 0, message.event_id);
    if (message.type === "hello") {
      this.attempts = 0;
      this.options.onState?.("open", "");
    }
    this.listeners.get(message.type)?.forEach((hear) => hear(message as never));
    // The stage answers while a page is being made of its greeting.
    if (message.type === "hello") this.greet(message);
    this.options.onMessage?.(message);
  }

  /** Goes on where it was, with what listeners have chosen after the greeting, too. */
  private greet(hello: Hello): void {
    this.hello = hello;
    for (const choice of this.choices) this.ask(choice, hello);
    if (this.lastEvent !== null) {
      // A daemon that was started anew counts from one again.
      const after = this.lastEvent > hello.last_event_id ? 0 : this.lastEvent;
      this.request({ type: "resume", after }).catch(ignore);
    }
    this.lastEvent = hello.last_event_id;
  }

  private lost(code: number, reason: string): void {
    const greeted = this.hello !== null;
    this.socket = null;
    this.end("the connection broke before the answer");
    // Another stage follows at the same address, and waits already.
    if (code === STAGE_CHANGED) {
      this.options.onState?.("connecting", reason);
      setTimeout(() => this.again(), CHANGES_MS);
    } else {
      void this.retry(greeted, reason || `connection lost (${code})`);
    }
  }

  private async retry(greeted: boolean, why: string): Promise<void> {
    // A browser does not say why a websocket was refused; the daemon reports it over HTTP.
    if (!greeted && (await this.isUnauthorised())) {
      this.options.onState?.("unauthorised", "");
      return;
    }
    if (this.closes) return;
    this.options.onState?.("lost", why);
    const wait_ms = RETRY_MS[Math.min(this.attempts++, RETRY_MS.length - 1)];
    setTimeout(() => this.again(), wait_ms);
  }

  /** Unless somebody has closed it, or connected it, meanwhile. */
  private again(): void {
    if (!this.closes && !this.socket) this.connect();
  }

  private async isUnauthorised(): Promise<boolean> {
    const token = this.token();
    const address = new URL("metrics", this.websocket().replace(/^ws/, "http"));
    try {
      const headers: Record<string, string> = token === null ? {} : { authorization: `Bearer ${token}` };
      return (await fetch(address, { headers, cache: "no-store" })).status === 401;
    } catch {
      return false;
    }
  }

  private end(why: string): void {
    this.hello = null;
    this.unsent = [];
    this.waiting.forEach(({ reject }) => reject(new Refused("lost", why)));
    this.waiting.clear();
  }
}
