// For the person who trains, two metres away: one thing at a time, large. Nothing here has to be touched while a plan runs.

import { el, setText } from "../dom";
import { advance, ownLanguage, say, sentenceOf, type Language } from "../feedback";
import type { Repetition } from "../model";
import type { ExerciseEventMessage, ExerciseProgress, ExerciseState, RunningSession } from "../protocol";
import { Person } from "../scene/person";
import type { Context, View } from "../view";

/** How long a sentence stands, ms: until the next repetition, or so long. */
const SENTENCE_MS = 6000;

const WORDS = {
  en: {
    wait: "Please wait: nothing is chosen yet.", ready: "Ready when you are.", rest: "Rest", next: "next", set: "set", of: "of",
    done: "Done. Thank you!", repetitions: "repetitions", language: "Language", aloud: "say it aloud", figure: "you, from the front, and see-through how it was shown",
  },
  de: {
    wait: "Bitte warten: Es ist noch nichts ausgewählt.", ready: "Los geht es, wenn du willst.", rest: "Pause", next: "danach", set: "Satz", of: "von",
    done: "Geschafft. Danke!", repetitions: "Wiederholungen", language: "Sprache", aloud: "vorlesen", figure: "du, von vorn, und durchscheinend, wie es gezeigt wurde",
  },
} satisfies Record<Language, Record<string, string>>;

/** What stands in the middle. */
type Shown = { title: string; large: string; small: string };

export class PatientView implements View {
  readonly id = "patient";
  readonly title = "Patient";
  readonly element: HTMLElement;
  private readonly name = el("h1", { id: "patient-title" });
  private readonly large = el("p", { id: "patient-count", class: "far-count" });
  private readonly small = el("p", { id: "patient-set", class: "far-small" });
  private readonly sentence = el("p", { id: "patient-sentence", class: "far-sentence", role: "status" });
  private readonly language = el("select", { id: "patient-language", "aria-label": "language" },
    el("option", { value: "en" }, "English"), el("option", { value: "de" }, "Deutsch"));
  private readonly aloud = el("input", { id: "patient-aloud", type: "checkbox" });
  private readonly aloudWords = el("span");
  private readonly person: Person;
  private state: ExerciseState | null = null;
  private session: RunningSession | null = null;
  /** A session has ended since the last selection. */
  private ended: RunningSession | null = null;
  private last: { repetition: Repetition; at_ms: number } | null = null;

  constructor(private readonly context: Context) {
    this.language.value = ownLanguage();
    this.person = new Person("patient-figure", WORDS[ownLanguage()].figure, context.link);
    const words = el("div", { class: "row" }, this.language, el("label", {}, this.aloud, " ", this.aloudWords));
    this.element = el("div", { class: "far" }, el("div", { class: "far-words" }, this.name, this.large, this.small, this.sentence),
      this.person.element, words);
    context.model.listen((message) => {
      const { subject: own } = context.model;
      if (message.type === "exercise" && (message.subject ?? own) === own) this.take(message);
      else if (message.type === "session") this.takeSession(message.sessions.find(({ subject }) => subject === own) ?? null);
      else if (message.type === "hello") this.state = this.session = this.ended = this.last = null;
    });
  }

  shown(): void {
    this.person.shown();
  }

  draw(now_ms: number): void {
    this.person.demonstrate(this.current()?.exercise ?? null);
    this.person.draw(this.context.model, now_ms);
    const language = this.language.value as Language;
    const { title, large, small } = this.now(WORDS[language]);
    setText(this.name, title);
    setText(this.large, large);
    setText(this.small, small);
    setText(this.aloudWords, WORDS[language].aloud);
    const fresh = this.last !== null && now_ms - this.last.at_ms < SENTENCE_MS;
    const said = (fresh ? sentenceOf(this.last!.repetition, language) : null) ?? { text: "", good: true };
    setText(this.sentence, said.text);
    this.sentence.className = `far-sentence ${said.good ? "good" : "care"}`;
    this.element.lang = language;
  }

  /** The one thing that is to be seen now. */
  private now(words: (typeof WORDS)[Language]): Shown {
    const plan = this.session?.plan ?? null;
    const now_s = this.context.model.sensors?.t_s ?? 0;
    if (this.ended) return { title: words.done, large: String(this.ended.counted), small: words.repetitions };
    if (plan !== null && plan.rest_until_s !== null) {
      return { title: words.rest, large: seconds(plan.rest_until_s - now_s), small: `${words.next}: ${plan.exercise}` };
    }
    const current = this.current();
    if (!current) return { title: words.wait, large: "", small: "" };
    if (current.rest_until_s !== null && current.rest_until_s > now_s) {
      return { title: words.rest, large: seconds(current.rest_until_s - now_s), small: `${words.next}: ${current.exercise}` };
    }
    const { repetitions, sets } = this.state!;
    const begun = current.set_count > 0 && !(repetitions !== null && current.set_count >= repetitions && !current.done);
    const set = sets === null ? `${words.set} ${current.set}` : `${words.set} ${current.set} ${words.of} ${sets}`;
    return {
      title: current.exercise,
      large: `${begun ? current.set_count : 0}${repetitions === null ? "" : ` / ${repetitions}`}`,
      small: current.count === 0 ? words.ready : set,
    };
  }

  /** What is done now: of several, the one that was done last. */
  private current(): ExerciseProgress | undefined {
    const exercises = this.state?.exercises ?? [];
    return exercises.find(({ exercise }) => exercise === this.last?.repetition.exercise) ?? exercises[0];
  }

  private take(message: ExerciseEventMessage): void {
    if (message.event === "loaded") this.person.taught();
    else if (message.event === "state") {
      if (message.state.exercises.every(({ count }) => count === 0)) this.last = null;
      this.state = message.state;
      // What is selected anew is not what has ended.
      if (message.state.exercises.some(({ done }) => !done)) this.ended = null;
    } else if (message.event === "counted" || message.event === "rejected") {
      advance(this.state, message);
      const language = this.language.value as Language;
      const said = sentenceOf(message, language);
      if (said === null) return;
      this.last = { repetition: message, at_ms: performance.now() };
      if (this.aloud.checked && !this.element.hidden) say(said.text, language);
    }
  }

  private takeSession(session: RunningSession | null): void {
    if (this.session !== null && session === null) this.ended = this.session;
    if (session !== null) this.ended = null;
    this.session = session;
  }
}

function seconds(left_s: number): string {
  return String(Math.max(0, Math.ceil(left_s)));
}
