// Trainer: teach an exercise, choose what is counted, see the count as bars, and one sentence after each repetition.

import { acting, el, prompt, setText } from "../dom";
import { advance, ownLanguage, say, sentenceOf, spokenIn, type Language } from "../feedback";
import { Person } from "../scene/person";
import type { ExerciseEventMessage, ExerciseProgress, ExerciseState, Job, KeptExercise, Score } from "../protocol";
import type { Repetition } from "../model";
import type { Context, View } from "../view";

/** Bars that are shown where a set has no end. */
const OPEN_BARS = 10;
const NOTHING = "Nothing is being counted. Choose an exercise below, or teach one.";

/** The parts of a score, as the person who moves reads them. */
const PARTS: Record<Language, [keyof Score, string][]> = {
  en: [["amplitude", "amplitude"], ["tempo", "tempo"], ["smoothness", "smoothness"], ["symmetry", "symmetry"]],
  de: [["amplitude", "Ausmaß"], ["tempo", "Tempo"], ["smoothness", "Gleichmaß"], ["symmetry", "Symmetrie"]],
};
const OF_100: Record<Language, string> = { en: "of 100", de: "von 100" };

export class TrainerView implements View {
  readonly id = "trainer";
  readonly title = "Trainer";
  readonly element: HTMLElement;
  private readonly says = el("p", { class: "says", role: "alert" });
  private readonly counts = el("div", { class: "counts" });
  private readonly sentence = el("p", { id: "feedback", class: "sentence", role: "status" });
  private readonly score = el("p", { id: "score", class: "quiet" });
  private readonly hint = el("p", { id: "hint", class: "quiet", role: "status" });
  private readonly language = el("select", { id: "language", "aria-label": "language of the feedback" },
    el("option", { value: "en" }, "English"), el("option", { value: "de" }, "Deutsch"));
  private readonly aloud = el("input", { id: "aloud", type: "checkbox" });
  private readonly name = el("input", { id: "teach-name", required: true, maxlength: 64, placeholder: "curl" });
  private readonly repetitions = el("input", { id: "teach-repetitions", type: "number", min: 3, max: 10, value: 5 });
  private readonly teach = el("button", { id: "teach", class: "primary" }, "Teach");
  private readonly cancel = el("button", { id: "teach-cancel", type: "button", hidden: true }, "Cancel");
  private readonly lesson = el("p", { id: "lesson", role: "status" });
  private readonly choice = el("fieldset", { id: "exercises" });
  private readonly target = el("input", { id: "target", type: "number", min: 1, max: 100, placeholder: "open" });
  private readonly sets = el("input", { id: "sets", type: "number", min: 1, max: 20, placeholder: "open" });
  private readonly rest = el("input", { id: "rest", type: "number", min: 0, max: 600, value: 30 });
  private readonly reset = el("button", { id: "reset", hidden: true }, "Reset");
  private readonly avatar: Person;
  private state: ExerciseState | null = null;
  /** Repetitions whose end is not confirmed yet, by exercise. */
  private readonly provisional = new Set<string>();
  /** The exercise that was done last. */
  private latest: string | null = null;
  private changed = true;

  constructor(private readonly context: Context) {
    const { link, model } = context;
    const label = "the person who wears the sensors, and see-through how the exercise was taught; Analysis shows the joint angles in numbers";
    this.avatar = new Person("avatar", label, link);
    const teach = el("form", { class: "row" },
      el("label", {}, "Name ", this.name), el("label", {}, "Repetitions ", this.repetitions),
      this.teach, this.cancel);
    teach.addEventListener("submit", acting(this.says, () => link.request({
      type: "exercise.teach", name: this.name.value.trim(), repetitions: Number(this.repetitions.value), ...model.about,
    })));
    this.cancel.addEventListener("click", acting(this.says, async () => {
      const job = this.job();
      if (job?.state === "running") await link.request({ type: "job.cancel", job: job.job });
    }));
    const select = el("form", {}, this.choice, el("div", { class: "row" },
      el("label", {}, "Repetitions of a set ", this.target), el("label", {}, "Sets ", this.sets),
      el("label", {}, "Rest, s ", this.rest), el("button", { id: "select", class: "primary" }, "Count these")));
    select.addEventListener("submit", acting(this.says, () => this.select()));
    this.reset.addEventListener("click", acting(this.says, () => link.request({ type: "exercise.reset", subject: model.subject })));
    this.language.value = ownLanguage();
    const words = el("div", { class: "row" }, el("label", {}, "Feedback in ", this.language),
      el("label", {}, this.aloud, " say it aloud"), this.reset);
    this.element = el("div", {}, this.avatar.element, this.counts, this.sentence, this.score, this.hint, words, this.says,
      el("h2", {}, "Teach an exercise"), teach, this.lesson,
      el("h2", {}, "What is counted"), select);
    model.listen((message) => {
      if (message.type === "exercise" && (message.subject ?? model.subject) === model.subject) this.take(message);
      else if (message.type === "jobs" || message.type === "status") this.changed = true;
      else if (message.type === "hello") void this.refresh();
    });
  }

  shown(): void {
    this.changed = true;
    this.avatar.shown();
    void this.refresh();
  }

  draw(now_ms: number): void {
    this.avatar.demonstrate(this.latest ?? this.state?.exercises[0]?.exercise ?? null);
    this.avatar.draw(this.context.model, now_ms);
    const rests = this.state?.exercises.some(({ rest_until_s }) => rest_until_s !== null) ?? false;
    if (!this.changed && !rests) return;
    this.changed = false;
    this.drawLesson();
    const exercises = this.state?.exercises ?? [];
    while (this.counts.children.length > exercises.length) this.counts.lastElementChild!.remove();
    exercises.forEach((progress, index) => {
      let row = this.counts.children[index];
      if (!row) this.counts.append((row = el("section", {}, el("h2"), el("div", { class: "bars" }), el("p", { class: "quiet" }))));
      this.drawProgress(row, progress);
    });
    this.reset.hidden = exercises.length === 0;
    if (exercises.length === 0) setText(this.sentence, NOTHING);
    else if (this.sentence.textContent === NOTHING) setText(this.sentence, "");
  }

  /** The newest lesson, running or not. */
  private job(): Job | undefined {
    return this.context.model.jobs?.jobs.filter(({ kind }) => kind === "exercise.teach").at(-1);
  }

  private drawLesson(): void {
    const { hello, status } = this.context.model;
    const job = this.job();
    const running = job?.state === "running";
    this.teach.disabled = running || hello?.role !== "operate" || !!status?.replay;
    this.cancel.hidden = !running;
    prompt(this.lesson, job, "Stand still, press the button, do the repetitions, and rest when they are done. What is taught is counted from then on.");
  }

  private drawProgress(row: Element, progress: ExerciseProgress): void {
    const [title, bars, words] = [row.children[0]!, row.children[1]!, row.children[2]!];
    setText(title, `${progress.exercise}: ${progress.count}`);
    const length = Math.max(this.state?.repetitions ?? OPEN_BARS, progress.set_count);
    while (bars.children.length < length) bars.append(el("span"));
    while (bars.children.length > length) bars.lastElementChild!.remove();
    [...bars.children].forEach((bar, index) => {
      const pending = index === progress.set_count && this.provisional.has(progress.exercise);
      bar.className = index < progress.set_count ? "done" : pending ? "pending" : "";
    });
    bars.setAttribute("role", "img");
    bars.setAttribute("aria-label", `${progress.set_count} of ${this.state?.repetitions ?? "any number"}`);
    const now_s = this.context.model.sensors?.t_s ?? 0;
    const left_s = progress.rest_until_s === null ? 0 : Math.max(0, progress.rest_until_s - now_s);
    const set = this.state?.sets ? `set ${progress.set} of ${this.state.sets}` : `set ${progress.set}`;
    setText(words, progress.done ? "all sets done" : left_s > 0 ? `rest for ${Math.ceil(left_s)} s` : set);
  }

  private take(message: ExerciseEventMessage): void {
    this.changed = true;
    switch (message.event) {
      case "state":
        this.state = message.state;
        if (!message.state.exercises.some(({ exercise }) => exercise === this.latest)) this.latest = null;
        break;
      case "loaded":
        this.avatar.taught();
        void this.refresh();
        break;
      case "started":
        setText(this.hint, "");
        break;
      case "provisional":
        this.provisional.add(message.exercise);
        break;
      case "withdrawn":
        this.provisional.delete(message.exercise);
        break;
      case "counted":
      case "rejected": {
        this.provisional.delete(message.exercise);
        advance(this.state, message);
        this.latest = message.exercise;
        this.judge(message);
        break;
      }
      case "hint":
        setText(this.hint, spokenIn(this.language.value as Language, message) ?? "");
        break;
    }
  }

  /** One sentence of a repetition, and its points. */
  private judge(message: Repetition): void {
    const language = this.language.value as Language;
    const said = sentenceOf(message, language);
    if (said === null) return;
    const { text, good } = said;
    setText(this.sentence, text);
    this.sentence.lang = language;
    this.sentence.className = `sentence ${good ? "good" : "care"}`;
    const { score } = message;
    const part = ([name, word]: [keyof Score, string]) => {
      const points = score?.[name] ?? null;
      return points === null ? [] : [`${word} ${Math.round(points)}`];
    };
    setText(this.score, score ? `${Math.round(score.total)} ${OF_100[language]}: ${PARTS[language].flatMap(part).join(", ")}` : "");
    this.score.lang = language;
    if (this.aloud.checked) say(text, language);
  }

  private boxes(): HTMLInputElement[] {
    return [...this.choice.querySelectorAll("input")];
  }

  private select(): Promise<unknown> {
    const exercises = this.boxes().filter((box) => box.checked).map((box) => box.value);
    const number = (input: HTMLInputElement) => (input.value === "" ? null : Number(input.value));
    return this.context.link.request({
      type: "exercise.select", exercises, ...this.context.model.about,
      repetitions: number(this.target), sets: number(this.sets), rest_s: number(this.rest),
    });
  }

  private async refresh(): Promise<void> {
    try {
      const { exercises } = await this.context.link.request({ type: "exercise.list" });
      const selected = new Set(this.state?.exercises.map(({ exercise }) => exercise));
      // What somebody has ticked since stays as it is.
      const ticked = new Map(this.boxes().map((box) => [box.value, box.checked]));
      const row = ({ name }: KeptExercise) => {
        const checked = ticked.get(name) ?? selected.has(name);
        return el("label", {}, el("input", { type: "checkbox", value: name, checked }), ` ${name} `);
      };
      this.choice.replaceChildren(el("legend", {}, "Exercises"), ...(exercises.length ? exercises.map(row) : ["none are taught yet"]));
    } catch {
      // Not connected yet, or a replay: the greeting or the next look asks again.
    }
  }
}
