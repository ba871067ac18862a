// Small helpers: elements by tag, tables whose cells are kept.

import type { Job } from "./protocol";

type Attributes = Record<string, string | number | boolean | EventListener>;
export type Child = Node | string;

/** An element with attributes (`onclick` and the like take functions) and children. */
export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false) element.setAttribute(name, String(value));
  }
  element.append(...children);
  return element;
}

export function setText(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** A cell: its text, and its class if it has one. */
export type Cell = [text: string, kind?: string];

/** A titled table whose rows are replaced cell by cell: selection and screen readers stay where they are. */
export class Table {
  readonly element: HTMLElement;
  private readonly body: HTMLTableSectionElement;
  /** The row that is renewed next. */
  private next = 0;

  constructor(id: string, title: string, columns: Cell[]) {
    this.body = el("tbody", { id });
    const head = el("thead", {}, el("tr", {}, ...columns.map(([text, kind = ""]) => el("th", { scope: "col", class: kind }, text))));
    const heading = el("h2", { id: `${id}-title` }, title);
    const scroll = { class: "scroll", tabindex: 0, role: "region", "aria-labelledby": `${id}-title` };
    this.element = el("section", { "aria-labelledby": `${id}-title` }, heading, el("div", scroll, el("table", {}, head, this.body)));
  }

  fill(rows: Cell[][]): void {
    while (this.body.rows.length > rows.length) this.body.deleteRow(-1);
    rows.forEach((cells, r) => this.fillRow(r, cells));
  }

  /** Renews at most so many rows, and the next ones when it is called again. */
  fillSome<T>(items: T[], most: number, cells: (item: T) => Cell[]): void {
    while (this.body.rows.length > items.length) this.body.deleteRow(-1);
    for (let count = Math.min(most, items.length); count > 0; count--) {
      // Rows that are not there yet come in their order.
      if (this.next >= items.length || this.next > this.body.rows.length) this.next = 0;
      this.fillRow(this.next, cells(items[this.next]!));
      this.next++;
    }
  }

  private fillRow(index: number, cells: Cell[]): void {
    const row = this.body.rows[index] ?? this.body.insertRow();
    cells.forEach(([text, kind = ""], c) => {
      const cell = row.cells[c] ?? row.insertCell();
      setText(cell, text);
      if (cell.className !== kind) cell.className = kind;
    });
  }
}

/** What to do next, to be read from afar; small, what a run is for, before there is one. */
export function prompt(element: HTMLElement, job: Job | undefined, otherwise: string): void {
  setText(element, job?.message ?? otherwise);
  element.className = !job ? "quiet" : `sentence ${job.state === "failed" ? "bad" : job.state === "done" ? "good" : ""}`;
}

/** A word of the messages as people read it. */
export function spoken(word: string): string {
  return word.replaceAll("_", " ");
}

/** A number with so many digits, or a dash. */
export function num(value: number | null | undefined, digits: number): string {
  return value === null || value === undefined || !Number.isFinite(value) ? "–" : value.toFixed(digits);
}

/** Runs an asynchronous action of a button, and shows what went wrong beside it. */
export function acting(says: HTMLElement, action: () => Promise<unknown>): EventListener {
  return (event) => {
    event.preventDefault();
    setText(says, "");
    action().catch((error: unknown) => setText(says, error instanceof Error ? error.message : String(error)));
  };
}
