// What events have said of exercises: how far each is, and what was said of the last repetition.

import { advance, sentenceOf } from "./feedback";
import type { Repetition } from "./model";
import { model } from "./page.svelte";
import type { ExerciseEventMessage, ExerciseState, RunningSession } from "./protocol";

type Hint = Extract<ExerciseEventMessage, { event: "hint" }>;
type Listener = (message: ExerciseEventMessage) => void;

class Training {
  state = $state.raw<ExerciseState | null>(null);
  /** The last repetition that something is said of, and when it came, browser time, ms. */
  judged = $state.raw<{ repetition: Repetition; at_ms: number } | null>(null);
  hint = $state.raw<Hint | null>(null);
  /** Repetitions whose end is not confirmed yet, by exercise. */
  provisional = $state.raw<readonly string[]>([]);
  /** The exercise that was done last. */
  latest = $state<string | null>(null);
  session = $state.raw<RunningSession | null>(null);
  /** A session has ended since the last selection. */
  ended = $state.raw<RunningSession | null>(null);
  /** Rises when an exercise was taught or loaded. */
  loaded = $state(0);
  private readonly listeners = new Set<Listener>();

  listen(listener: Listener): () => void {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  }

  take(message: ExerciseEventMessage): void {
    switch (message.event) {
      case "state":
        this.state = message.state;
        if (!message.state.exercises.some(({ exercise }) => exercise === this.latest)) this.latest = null;
        if (message.state.exercises.every(({ count }) => count === 0)) this.judged = null;
        // What is selected anew is not what has ended.
        if (message.state.exercises.some(({ done }) => !done)) this.ended = null;
        break;
      case "loaded":
        this.loaded++;
        break;
      case "started":
        this.hint = null;
        break;
      case "provisional":
        this.provisional = [...this.provisional, message.exercise];
        break;
      case "withdrawn":
        this.confirm(message.exercise);
        break;
      case "counted":
      case "rejected":
        this.confirm(message.exercise);
        this.state = advance(this.state, message);
        this.latest = message.exercise;
        if (sentenceOf(message, "en") !== null) this.judged = { repetition: message, at_ms: performance.now() };
        break;
      case "hint":
        this.hint = message;
        break;
    }
    this.listeners.forEach((listener) => listener(message));
  }

  takeSession(session: RunningSession | null): void {
    if (this.session !== null && session === null) this.ended = this.session;
    if (session !== null) this.ended = null;
    this.session = session;
  }

  forget(): void {
    this.state = this.session = this.ended = this.judged = this.hint = this.latest = null;
    this.provisional = [];
  }

  private confirm(exercise: string): void {
    this.provisional = this.provisional.filter((each) => each !== exercise);
  }
}

export const training = new Training();
model.listen((message) => {
  const { subject: own } = model;
  if (message.type === "hello") training.forget();
  else if (message.type === "exercise" && (message.subject ?? own) === own) training.take(message);
  else if (message.type === "session") training.takeSession(message.sessions.find(({ subject }) => subject === own) ?? null);
});
