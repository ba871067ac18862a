// What a button does, and what went wrong with it.

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
      this.says = error instanceof Error ? error.message : String(error);
    }
  }
}
