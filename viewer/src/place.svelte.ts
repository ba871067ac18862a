// Which view is shown, as the address has it.

/** In the order of the tabs: what somebody does, from seeing that it tracks to what was wrong. */
export const VIEWS = ["watch", "setup", "calibrate", "coach", "exercise", "plan", "analyse", "takes", "check"] as const;
/** The wall has no tab: nothing on it is to be pressed. */
export type ViewName = (typeof VIEWS)[number] | "wall";

const viewOf = (hash: string): ViewName | undefined => [...VIEWS, "wall" as const].find((view) => `#${view}` === hash);

class Place {
  view = $state<ViewName>(viewOf(location.hash) ?? "watch");
  /** Only these have been made: most pages stay with one. */
  visited = $state<ViewName[]>([]);

  constructor() {
    this.visited = [this.view];
    addEventListener("hashchange", () => {
      const view = viewOf(location.hash);
      if (view) this.go(view);
    });
  }

  /** Shows a view, and says so in the address; a page that was opened without one in it keeps the focus at its top. */
  go(view: ViewName): void {
    this.view = view;
    if (!this.visited.includes(view)) this.visited.push(view);
    history.replaceState(null, "", `#${view}`);
  }
}

export const place = new Place();
