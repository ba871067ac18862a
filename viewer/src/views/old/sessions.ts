// Sessions: begin and end one, make a plan, look at what was trained, read and keep the report.

import { acting, el, num, setText } from "../dom";
import type { Plan, PlanStep, RunningSession, SessionSummary } from "../protocol";
import type { Context, View } from "../view";
import { SessionSets } from "./session-sets";

type ReportOf = { session: number } | { person: string };

/** A row of a plan that is being made. */
class StepRow {
  readonly exercise = el("input", { class: "step-exercise", list: "known-exercises", required: true, maxlength: 64, placeholder: "exercise", "aria-label": "exercise" });
  readonly sets = el("input", { type: "number", min: 1, max: 100, value: 3, "aria-label": "sets" });
  readonly repetitions = el("input", { type: "number", min: 1, max: 1000, value: 8, "aria-label": "repetitions" });
  readonly rest = el("input", { type: "number", min: 0, max: 3600, value: 60, "aria-label": "rest in seconds" });
  readonly element: HTMLElement;

  constructor(step: PlanStep | null, remove: (row: StepRow) => void) {
    if (step) {
      this.exercise.value = step.exercise;
      this.sets.value = String(step.sets);
      this.repetitions.value = String(step.repetitions);
      this.rest.value = String(step.rest_s);
    }
    this.element = el("div", { class: "row" }, this.exercise, this.sets, " sets of ", this.repetitions, " rest, s ", this.rest,
      el("button", { type: "button", onclick: () => remove(this) }, "Remove"));
  }

  step(): PlanStep {
    return {
      exercise: this.exercise.value.trim(), sets: Number(this.sets.value),
      repetitions: Number(this.repetitions.value), rest_s: Number(this.rest.value),
    };
  }
}

export class SessionsView implements View {
  readonly id = "sessions";
  readonly title = "Sessions";
  readonly element: HTMLElement;
  private readonly says = el("p", { class: "says", role: "alert" });
  private readonly now = el("p", { id: "session-now", role: "status" });
  private readonly person = el("input", { id: "session-person", list: "known-people", required: true, maxlength: 64, placeholder: "name or number" });
  private readonly people = el("datalist", { id: "known-people" });
  private readonly exercises = el("datalist", { id: "known-exercises" });
  private readonly plan = el("select", { id: "session-plan" });
  private readonly begin = el("button", { id: "session-begin", class: "primary" }, "Begin");
  private readonly end = el("button", { id: "session-end", type: "button", hidden: true }, "End session");
  private readonly planName = el("input", { id: "plan-name", required: true, maxlength: 64, placeholder: "week 1" });
  private readonly steps = el("div", { id: "plan-steps" });
  private readonly list = el("tbody", { id: "session-list" });
  private readonly of = el("select", { id: "session-of", "aria-label": "sessions of" });
  private readonly language = el("select", { id: "report-language", "aria-label": "language of the report" },
    el("option", { value: "english" }, "English"), el("option", { value: "german" }, "Deutsch"));
  private readonly save = el("a", { id: "report-save", hidden: true }, "Save the report");
  // Nothing in it may run: a name is a name.
  private readonly report = el("iframe", { id: "report", class: "report", sandbox: "", title: "Report", hidden: true });
  private readonly sets: SessionSets;
  private rows: StepRow[] = [];
  private plans: Plan[] = [];
  private running: RunningSession[] = [];
  private changed = true;

  constructor(private readonly context: Context) {
    const { link, model } = context;
    this.sets = new SessionSets(context);
    const begin = el("form", { class: "row" }, el("label", {}, "Who ", this.person), this.people,
      el("label", {}, "Plan ", this.plan), this.begin, this.end);
    begin.addEventListener("submit", acting(this.says, () => link.request({
      type: "session.begin", person: this.person.value.trim(), plan: this.plan.value || null, subject: model.subject,
    })));
    this.end.addEventListener("click", acting(this.says, () => link.request({ type: "session.end", subject: model.subject })));
    const another = el("button", { id: "plan-another", type: "button", onclick: () => this.addStep(null) }, "Another exercise");
    const remove = el("button", { id: "plan-delete", type: "button" }, "Delete plan");
    const plan = el("form", {}, el("div", { class: "row" }, el("label", {}, "Name ", this.planName)), this.exercises, this.steps,
      el("div", { class: "row" }, another, el("button", { id: "plan-save", class: "primary" }, "Save plan"), remove));
    plan.addEventListener("submit", acting(this.says, async () => {
      await link.request({ type: "session.save_plan", plan: { name: this.planName.value.trim(), steps: this.rows.map((row) => row.step()) } });
      await this.refresh();
      this.plan.value = this.planName.value.trim();
    }));
    remove.addEventListener("click", acting(this.says, async () => {
      await link.request({ type: "session.delete_plan", name: this.planName.value.trim() });
      await this.refresh();
    }));
    // A plan that exists is shown as it is, to be changed.
    this.planName.addEventListener("change", () => {
      const known = this.plans.find(({ name }) => name === this.planName.value.trim());
      if (known) this.showPlan(known);
    });
    this.language.value = navigator.language.startsWith("de") ? "german" : "english";
    const weeks = el("button", { id: "report-weeks", type: "button" }, "Report over all sessions");
    weeks.addEventListener("click", acting(this.says, async () => {
      if (this.of.value === "") throw new Error("Choose whose sessions.");
      await this.show({ person: this.of.value });
    }));
    const forget = el("button", { id: "forget", type: "button" }, "Forget this person");
    forget.addEventListener("click", acting(this.says, () => this.forget()));
    this.of.addEventListener("change", () => void this.refresh());
    const head = ["", "begun", "who", "min", "plan", "sets", "counted", "not", "score", ""].map((text) => el("th", { scope: "col" }, text));
    this.element = el("div", {}, this.now, this.says, begin,
      el("h2", {}, "A plan"), plan,
      el("h2", {}, "What was trained"),
      el("div", { class: "row" }, el("label", {}, "Of ", this.of), weeks, el("label", {}, "in ", this.language), this.save, forget),
      el("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "sessions" },
        el("table", {}, el("thead", {}, el("tr", {}, ...head)), this.list)),
      this.sets.element, this.report);
    this.addStep(null);
    model.listen((message) => {
      if (message.type === "session") {
        const ended = message.sessions.length < this.running.length;
        this.running = message.sessions;
        this.changed = true;
        if (ended) void this.refresh();
      } else if (message.type === "hello") {
        this.changed = true;
        // Who looks at another view has no use for it yet.
        if (!this.element.hidden) void this.refresh();
      }
    });
  }

  shown(): void {
    this.changed = true;
    void this.refresh();
  }

  draw(): void {
    const rests = this.running.some(({ plan }) => plan !== null && plan.rest_until_s !== null);
    if (!this.changed && !rests) return;
    this.changed = false;
    const { hello, status } = this.context.model;
    this.begin.disabled = hello?.role !== "operate" || !!status?.replay;
    this.end.hidden = !this.running.some(({ subject }) => subject === this.context.model.subject);
    setText(this.now, this.running.map((session) => this.words(session)).join(" ") || "Nobody trains now.");
  }

  private words({ person, session, counted, plan, problem }: RunningSession): string {
    const words = [`${person} trains (session ${session}): ${counted} counted`];
    if (plan) words.push(`plan ${plan.name}, step ${plan.step} of ${plan.steps}: ${plan.exercise}`);
    const now_s = this.context.model.sensors?.t_s ?? 0;
    if (plan?.rest_until_s) words.push(`rest for ${Math.max(0, Math.ceil(plan.rest_until_s - now_s))} s`);
    if (problem) words.push(problem);
    return `${words.join("; ")}.`;
  }

  private addStep(step: PlanStep | null): void {
    const row = new StepRow(step, (gone) => {
      this.rows = this.rows.filter((each) => each !== gone);
      gone.element.remove();
    });
    this.rows.push(row);
    this.steps.append(row.element);
  }

  private showPlan(plan: Plan): void {
    this.rows = [];
    this.steps.replaceChildren();
    plan.steps.forEach((step) => this.addStep(step));
  }

  /** What the daemon keeps, asked anew. */
  private async refresh(): Promise<void> {
    const { link } = this.context;
    try {
      const person = this.of.value || null;
      const { people } = await link.request({ type: "session.people" });
      const known = people.some(({ name }) => name === person);
      const [{ sessions }, { plans }, { exercises }] = await Promise.all([
        link.request({ type: "session.list", person: known ? person : null }),
        link.request({ type: "session.plans" }), link.request({ type: "exercise.list" }),
      ]);
      const options = (names: string[], none: string, chosen: string) =>
        [el("option", { value: "" }, none), ...names.map((name) => el("option", { value: name, selected: name === chosen }, name))];
      this.plans = plans;
      this.people.replaceChildren(...people.map(({ name }) => el("option", { value: name })));
      this.exercises.replaceChildren(...exercises.map(({ name }) => el("option", { value: name })));
      this.plan.replaceChildren(...options(plans.map(({ name }) => name), "none", this.plan.value));
      this.of.replaceChildren(...options(people.map(({ name }) => name), "everybody", person ?? ""));
      this.list.replaceChildren(...sessions.map((session) => this.row(session)));
    } catch {
      // Not connected yet, a replay, or a token that may only watch: the next look asks again.
    }
  }

  private row(summary: SessionSummary): HTMLElement {
    const { session, person, begun, duration_s, plan, sets, counted, rejected, score } = summary;
    const read = el("button", { type: "button" }, "Report");
    read.addEventListener("click", acting(this.says, () => this.show({ session })));
    const look = el("button", { type: "button" }, "Sets");
    look.addEventListener("click", acting(this.says, () => this.sets.show(session)));
    const minutes = duration_s === undefined || duration_s === null ? "goes on" : num(duration_s / 60, 0);
    const cells = [String(session), new Date(begun).toLocaleString(), person, minutes, plan ?? "", String(sets), String(counted),
      String(rejected), num(score, 0)];
    return el("tr", {}, ...cells.map((cell) => el("td", {}, cell)), el("td", {}, read, " ", look));
  }

  private async show(of: ReportOf): Promise<void> {
    const time_zone = Intl.DateTimeFormat().resolvedOptions().timeZone;
    const language = this.language.value as "english" | "german";
    const { html } = await this.context.link.request({ type: "session.report", language, time_zone, ...of });
    this.report.srcdoc = html;
    this.report.hidden = false;
    URL.revokeObjectURL(this.save.href);
    this.save.href = URL.createObjectURL(new Blob([html], { type: "text/html" }));
    this.save.download = "session" in of ? `session-${of.session}.html` : "sessions.html";
    this.save.hidden = false;
  }

  private async forget(): Promise<void> {
    const person = this.of.value;
    if (person === "") throw new Error("Choose whom.");
    if (!window.confirm(`Remove ${person} with all sessions and their recordings? This cannot be undone.`)) return;
    await this.context.link.request({ type: "session.forget", person, recordings: true });
    this.of.value = "";
    this.report.hidden = this.save.hidden = true;
    this.sets.hide();
    await this.refresh();
  }
}
