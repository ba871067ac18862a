// The trainer's connection to the daemon, without a page: what it knows, and what it can ask for.
//
// In: messages of the websocket. Out: a `State` after every change. It reconnects by itself; what happened meanwhile
// it learns from the last state that every subscription is answered with.
import type { Answers, ClientMessage, ServerMessage } from "../../docs/schema/posed.v1.ts";

type Unnumbered<T> = T extends unknown ? Omit<T, "id"> : never;
type Reply = Extract<ServerMessage, { type: "ok" } | { type: "error" }>;
type ExerciseMessage = Extract<ServerMessage, { type: "exercise" }>;
type Selected = Extract<ExerciseMessage, { event: "state" }>["state"];

export interface State {
  link: "connecting" | "live" | "lost";
  stage: string;
  /** Names of the exercises that can be selected. */
  known: string[];
  /** What is counted, and of how many; repetitions that seem complete and are not counted yet. */
  selected: Selected | null;
  provisional: string[];
  /** On the last repetition, and while moving. */
  feedback: { good: boolean; text: string } | null;
  hint: string | null;
  /** What teaching is at. */
  teaching: { job: number; text: string; over: boolean } | null;
  error: string | null;
}

const RETRY_MS = [500, 1000, 2000, 5000];

export class Session {
  state: State = {
    link: "connecting", stage: "", known: [], selected: null, provisional: [], feedback: null, hint: null, teaching: null, error: null,
  };
  #socket!: WebSocket;
  #attempts = 0;
  #nextId = 1;
  #waiting = new Map<unknown, (reply: Reply) => void>();

  constructor(readonly open: () => WebSocket, readonly changed: (state: State) => void, readonly subject = "default") {
    this.connect();
  }

  connect(): void {
    this.#socket = this.open();
    this.#socket.onopen = () => {
      this.#attempts = 0;
      this.change({ link: "live", error: null, selected: null });
      this.ask({ type: "subscribe", topics: ["exercise", "jobs"] });
      this.list();
    };
    this.#socket.onmessage = ({ data }) => this.take(JSON.parse(data) as ServerMessage);
    this.#socket.onclose = () => {
      this.#waiting.clear();
      this.change({ link: "lost", hint: null });
      setTimeout(() => this.connect(), RETRY_MS[Math.min(this.#attempts++, RETRY_MS.length - 1)]);
    };
  }

  /** Counts one exercise from 0. */
  select(exercise: string, repetitions: number, sets: number, restS: number): void {
    this.ask({ type: "exercise.select", subject: this.subject, exercises: [exercise], repetitions, sets, rest_s: restS });
  }

  /** Learns an exercise from the repetitions that follow; it ends by itself once they were done. */
  teach(name: string, repetitions: number): void {
    this.change({ feedback: null });
    this.ask({ type: "exercise.teach", subject: this.subject, name, repetitions }, (result) => {
      this.change({ teaching: { job: (result as Answers["exercise.teach"]).job, text: "starting", over: false } });
    });
  }

  cancelTeaching(): void {
    if (this.state.teaching?.over === false) this.ask({ type: "job.cancel", job: this.state.teaching.job });
  }

  list(): void {
    this.ask({ type: "exercise.list" }, (result) => {
      for (const { name } of (result as Answers["exercise.list"]).exercises) this.learn(name);
    });
  }

  /** Sends a request; `then` gets its result, a refusal becomes the state's error. */
  ask(request: Unnumbered<ClientMessage>, then: (result: unknown) => void = () => {}): void {
    const id = this.#nextId++;
    this.#waiting.set(id, (reply) => (reply.type === "ok" ? then(reply.result) : this.change({ error: reply.message })));
    this.#socket.send(JSON.stringify({ ...request, id }));
  }

  /** Takes a message of the daemon. */
  take(message: ServerMessage): void {
    if (message.type === "hello") this.change({ stage: message.stage });
    if (message.type === "ok" || message.type === "error") {
      this.#waiting.get(message.id)?.(message);
      this.#waiting.delete(message.id);
    }
    if (message.type === "exercise") this.happened(message);
    const job = message.type === "jobs" && message.jobs.find(({ job }) => job === this.state.teaching?.job);
    if (job) {
      const over = job.state !== "running";
      if (over && this.state.teaching?.over === false) this.list();
      this.change({ teaching: { job: job.job, text: job.message ?? job.state, over } });
    }
  }

  private happened(event: ExerciseMessage): void {
    if (event.event === "loaded") return this.learn(event.exercise);
    if (event.subject !== this.subject) return;
    if (event.event === "state") return this.change({ selected: event.state });
    const hint = event.event === "hint" && (event.sentence ?? (event.anomaly ? "this is another movement" : null));
    if (hint !== false) return this.change({ hint });
    const others = this.state.provisional.filter((name) => name !== event.exercise);
    this.change({ provisional: event.event === "provisional" ? [...others, event.exercise] : others });
    if (event.event === "started") this.update(event.exercise, { rest_until_s: null });
    if (event.event === "counted" || event.event === "rejected") {
      const good = event.event === "counted";
      // Of a movement that was not meant nothing is said.
      if (good || event.sentence) this.change({ feedback: { good, text: event.sentence ?? "good" } });
      this.update(event.exercise, { count: event.count, set_count: event.set_count });
    }
  }

  private update(name: string, change: Partial<Selected["exercises"][number]>): void {
    const { selected } = this.state;
    const exercises = selected?.exercises.map((one) => (one.exercise === name ? { ...one, ...change } : one));
    if (selected && exercises) this.change({ selected: { ...selected, exercises } });
  }

  private learn(name: string): void {
    if (!this.state.known.includes(name)) this.change({ known: [...this.state.known, name].sort() });
  }

  private change(change: Partial<State>): void {
    this.state = { ...this.state, ...change };
    this.changed(this.state);
  }
}
