// What a view is. Only the one that is shown is drawn, and only while the tab is visible.

import type { Link } from "./link";
import type { Model } from "./model";

export interface Context {
  readonly model: Model;
  readonly link: Link;
}

export interface View {
  /** Word in the address, after `#`. */
  readonly id: string;
  /** Word on its tab. */
  readonly title: string;
  readonly element: HTMLElement;
  /** It is shown now. */
  shown?(): void;
  /** Called once per animation frame while shown; `fresh` when something came since the last call. */
  draw(now_ms: number, fresh: boolean): void;
}
