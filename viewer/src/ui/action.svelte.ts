// What a button does, and what went wrong with it.

import { Refused } from "../link";
import { words } from "../text/index.svelte";

/** What went wrong, in the language of the page where that has it. */
export function saidOf(error: unknown): string {
  if (error instanceof Refused) return (error.reason && words.text.daemon.refused(error.reason, error.values)) ?? error.message;
  return error instanceof Error ? error.message : String(error);
}

export class Action {
  says = $state("");

  /** Runs it for an event; what it is refused with is shown beside the button. */
  readonly on = (does: () => Promise<unknown>) => (event: Event): void => {
    event.preventDefault();
    void this.run(does);
  };

  async run(does: () => Promise<unknown>): Promise<void> {
    this.says = "";
    try {
      await does();
    } catch (error) {
      this.says = saidOf(error);
    }
  }
}
