// The trainer's connection to the daemon, without a page: what it knows, and what it can ask for.
//
// In: messages of the websocket. Out: a `State` after every change. It reconnects by itself; what happened meanwhile
// it learns from the last state that every subscription is answered with.
import type { Answers, ClientMessage, ServerMessage } from "../../docs/schema/posed.v1.ts";

/** An exercise as the page shows it. */
export interface Exercise {
  name: string;
  /** Repetitions since it was selected or reset. */
  count: number;
  set: number;
  setCount: number;
  /** Stage time at which the rest is over. */
  restUntilS: number | null;
  done: boolean;
  /** A repetition that seems complete and is not counted yet. */
  provisional: boolean;
}

export interface State {
  link: "connecting" | "live" | "lost";
  stage: string;
  /** Names of the exercises that can be selected. */
  known: string[];
  /** Those that are counted. */
  exercises: Exercise[];
  /** Repetitions of a set and number of sets. */
  repetitions: number | null;
  sets: number | null;
  /** On the last repetition. */
  feedback: { good: boolean; text: string } | null;
  /** While moving. */
  hint: string | null;
  /** What teaching is at. */
  teaching: { job: number; text: string; over: boolean } | null;
  error: string | null;
}

/** What a browser's WebSocket offers, and what a test can. */
export interface Socket {
  send(text: string): void;
  close(): void;
  onopen: (() => void) | null;
  onmessage: ((event: { data: string }) => void) | null;
  onclose: (() => void) | null;
}

type Unnumbered<T> = T extends unknown ? Omit<T, "id"> : never;
type Asked = Unnumbered<ClientMessage>;
type Reply = Extract<ServerMessage, { type: "ok" } | { type: "error" }>;
type ExerciseMessage = Extract<ServerMessage, { type: "exercise" }>;

const RETRY_MS = [500, 1000, 2000, 5000];

export class Session {
  state: State = {
    link: "connecting", stage: "", known: [], exercises: [], repetitions: null, sets: null, feedback: null, hint: null,
    teaching: null, error: null,
  };
  #socket: Socket | null = null;
  #attempts = 0;
  #nextId = 1;
  #waiting = new Map<number, (reply: Reply) => void>();

  constructor(
    readonly open: () => Socket,
    readonly changed: (state: State) => void,
    readonly subject = "default",
  ) {
    this.connect();
  }

  connect(): void {
    const socket = this.open();
    this.#socket = socket;
    socket.onopen = () => {
      this.#attempts = 0;
      this.change({ link: "live", error: null, exercises: [] });
      this.ask({ type: "subscribe", topics: ["exercise", "jobs"] });
      this.list();
    };
    socket.onmessage = ({ data }) => this.take(JSON.parse(data) as ServerMessage);
    socket.onclose = () => {
      this.#waiting.clear();
      this.change({ link: "lost", hint: null });
      const wait = RETRY_MS[Math.min(this.#attempts++, RETRY_MS.length - 1)];
      setTimeout(() => this.connect(), wait);
    };
  }

  /** Counts one exercise from 0. */
  select(exercise: string, repetitions: number, sets: number, restS: number): void {
    this.ask({
      type: "exercise.select", subject: this.subject, exercises: [exercise], repetitions, sets, rest_s: restS,
    });
  }

  reset(): void {
    this.ask({ type: "exercise.reset", subject: this.subject });
  }

  /** Learns an exercise from the repetitions that follow; it ends by itself once they were done. */
  teach(name: string, repetitions: number): void {
    this.change({ feedback: null });
    this.ask({ type: "exercise.teach", subject: this.subject, name, repetitions }, (reply) => {
      const result = reply.type === "ok" ? reply.result as Answers["exercise.teach"] : null;
      if (result) this.change({ teaching: { job: result.job, text: "starting", over: false } });
    });
  }

  cancelTeaching(): void {
    if (this.state.teaching && !this.state.teaching.over) {
      this.ask({ type: "job.cancel", job: this.state.teaching.job });
    }
  }

  list(): void {
    this.ask({ type: "exercise.list" }, (reply) => {
      const result = reply.type === "ok" ? reply.result as Answers["exercise.list"] : null;
      for (const { name } of result?.exercises ?? []) this.learn(name);
    });
  }

  ask(request: Asked, then: (reply: Reply) => void = () => {}): void {
    const id = this.#nextId++;
    this.#waiting.set(id, then);
    this.#socket?.send(JSON.stringify({ ...request, id }));
  }

  /** Takes a message of the daemon. */
  take(message: ServerMessage): void {
    switch (message.type) {
      case "hello":
        this.change({ stage: message.stage });
        break;
      case "ok":
      case "error": {
        if (message.type === "error") this.change({ error: message.message });
        const id = message.id as number;
        const then = this.#waiting.get(id);
        this.#waiting.delete(id);
        then?.(message);
        break;
      }
      case "jobs": {
        const job = message.jobs.find((job) => job.job === this.state.teaching?.job);
        if (job) {
          const over = job.state !== "running";
          if (over && this.state.teaching?.over === false) this.list();
          this.change({ teaching: { job: job.job, text: job.message ?? job.state, over } });
        }
        break;
      }
      case "exercise":
        this.happened(message);
        break;
    }
  }

  private happened(event: ExerciseMessage): void {
    if (event.event === "loaded") {
      this.learn(event.exercise);
      return;
    }
    if (event.subject !== this.subject) return;
    switch (event.event) {
      case "state":
        this.change({
          repetitions: event.state.repetitions,
          sets: event.state.sets,
          exercises: event.state.exercises.map((one) => ({
            name: one.exercise, count: one.count, set: one.set, setCount: one.set_count,
            restUntilS: one.rest_until_s, done: one.done, provisional: false,
          })),
        });
        break;
      case "started":
        this.update(event.exercise, { restUntilS: null });
        break;
      case "provisional":
      case "withdrawn":
        this.update(event.exercise, { provisional: event.event === "provisional" });
        break;
      case "counted":
      case "rejected": {
        const good = event.event === "counted";
        // Of a movement that was not meant nothing is said.
        if (good || event.sentence) this.change({ feedback: { good, text: event.sentence ?? "good" } });
        this.update(event.exercise, { count: event.count, setCount: event.set_count, provisional: false });
        break;
      }
      case "hint":
        this.change({ hint: event.sentence ?? (event.anomaly ? "this is another movement" : null) });
        break;
    }
  }

  private update(name: string, change: Partial<Exercise>): void {
    this.change({ exercises: this.state.exercises.map((one) => (one.name === name ? { ...one, ...change } : one)) });
  }

  private learn(name: string): void {
    if (!this.state.known.includes(name)) this.change({ known: [...this.state.known, name].sort() });
  }

  private change(change: Partial<State>): void {
    this.state = { ...this.state, ...change };
    this.changed(this.state);
  }
}
