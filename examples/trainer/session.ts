// What a trainer knows, and what it can ask for, without a page.
//
// In: a client of the daemon. Out: a `State` after every change. What happened while there was no connection it learns from the last
// state that every subscription is answered with.
import { type Client, type LinkState, type Message, type Request } from "../../clients/typescript/src/client";

type ExerciseMessage = Message<"exercise">;
type Selected = Extract<ExerciseMessage, { event: "state" }>["state"];

export interface State {
  link: LinkState;
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

export class Session {
  state: State = {
    link: "connecting", stage: "", known: [], selected: null, provisional: [], feedback: null, hint: null, teaching: null, error: null,
  };

  constructor(readonly client: Client, readonly changed: (state: State) => void, readonly subject = "default") {
    client.on("hello", ({ stage }) => {
      this.change({ stage, error: null, selected: null });
      this.list();
    });
    client.on("exercise", (event) => this.happened(event));
    client.on("jobs", ({ jobs }) => this.taught(jobs));
    client.subscribe({ topics: ["exercise", "jobs"] });
  }

  /** What became of the connection: for the client's `onState`. */
  linked(link: LinkState): void {
    this.change({ link, ...(link === "open" ? {} : { hint: null }) });
  }

  /** Counts one exercise from 0. */
  select(exercise: string, repetitions: number, sets: number, restS: number): void {
    this.ask({ type: "exercise.select", subject: this.subject, exercises: [exercise], repetitions, sets, rest_s: restS });
  }

  /** Learns an exercise from the repetitions that follow; it ends by itself once they were done. */
  async teach(name: string, repetitions: number): Promise<void> {
    this.change({ feedback: null });
    const begun = await this.ask({ type: "exercise.teach", subject: this.subject, name, repetitions });
    if (begun) this.change({ teaching: { job: begun.job, text: "starting", over: false } });
  }

  cancelTeaching(): void {
    if (this.state.teaching?.over === false) this.ask({ type: "job.cancel", job: this.state.teaching.job });
  }

  async list(): Promise<void> {
    const answer = await this.ask({ type: "exercise.list" });
    for (const { name } of answer?.exercises ?? []) this.learn(name);
  }

  /** Sends a request; a refusal becomes the state's error. */
  ask<R extends Request>(request: R) {
    return this.client.request(request).catch((refused: Error) => void this.change({ error: refused.message }));
  }

  private taught(jobs: Message<"jobs">["jobs"]): void {
    const job = jobs.find(({ job }) => job === this.state.teaching?.job);
    if (!job) return;
    const over = job.state !== "running";
    if (over && this.state.teaching?.over === false) this.list();
    this.change({ teaching: { job: job.job, text: job.message ?? job.state, over } });
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
