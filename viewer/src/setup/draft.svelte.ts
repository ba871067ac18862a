// The stage file as it would be with the changes of this page: made by the daemon, and not written before somebody saves.

import { Refused } from "../link";
import { link, live, model } from "../page.svelte";
import { saidOf } from "../ui/action.svelte";
import type { Setup, SetupProblem, StageChange, StageTable } from "../protocol";

class Draft {
  /** What the file says with the changes; null before it was read. */
  setup = $state.raw<Setup | null>(null);
  /** Not written yet. */
  changes = $state.raw<StageChange[]>([]);
  /** What went wrong last. */
  says = $state("");
  saving = $state(false);
  /** Somebody looks at it. */
  private wanted = false;
  /** The file that was read before a save whose answer got lost. */
  private unanswered: string | null = null;
  /** What was asked for last. */
  private last = Promise.resolve();

  constructor() {
    // A stage that began anew, or another connection.
    model.listen((message) => {
      if (message.type === "hello" && this.wanted) void this.read();
    });
  }

  get editable(): boolean {
    return live.operates && this.setup?.why_not === null;
  }

  /** What is wrong with a device, a sensor or a body, or with one of its keys. */
  problems(table: StageTable, name: string, key?: string): SetupProblem[] {
    const of = ({ problems }: Setup) => problems.filter((problem) => problem.table === table && problem.name === name && (key === undefined || problem.key === key));
    return this.setup ? of(this.setup) : [];
  }

  /** Reads it once somebody looks, and after every greeting. */
  open(): void {
    if (this.wanted) return;
    this.wanted = true;
    if (live.linkState === "open") void this.read();
  }

  async read(): Promise<void> {
    // Who may only watch may not read it either.
    if (!live.operates) return;
    try {
      const file = await link.request({ type: "setup.read" });
      if (this.unanswered !== null && this.unanswered !== file.revision) this.changes = [];
      this.unanswered = null;
      this.setup = this.changes.length === 0 ? file : await link.request({ type: "setup.read", changes: this.changes });
      this.saving = false;
    } catch (error) {
      this.fail(error);
    }
  }

  /** Makes changes, unless the daemon refuses them; one after the other. */
  add(...changes: StageChange[]): Promise<void> {
    return (this.last = this.last.then(() => this.make(changes)));
  }

  private async make(changes: StageChange[]): Promise<void> {
    const all = [...this.changes, ...changes];
    try {
      this.says = "";
      this.setup = await link.request({ type: "setup.read", changes: all });
      this.changes = all;
    } catch (error) {
      this.fail(error);
    }
  }

  discard(): void {
    this.changes = [];
    this.says = "";
    void this.read();
  }

  save(): Promise<void> {
    return (this.last = this.last.then(() => this.write()));
  }

  private async write(): Promise<void> {
    const { setup, changes } = this;
    if (!setup) return;
    this.saving = true;
    try {
      this.says = "";
      await link.request({ type: "setup.save", changes, revision: setup.revision });
      this.changes = [];
      // The stage begins anew, and is read with its greeting; one that did not change begins not.
      setTimeout(() => (this.saving = false), 5000);
    } catch (error) {
      if (error instanceof Refused && error.code === "lost") this.unanswered = setup.revision;
      else this.fail(error);
    }
  }

  private fail(error: unknown): void {
    this.saving = false;
    this.says = saidOf(error);
  }
}

export const draft = new Draft();
