// The fault map: its cells by class, the cell that wins now, and what it reports about each sensor. Part of Analysis.

import { type Cell, Table, acting, el, num, setText, spoken } from "../dom";
import type { FaultClass, FaultMap } from "../protocol";
import type { Context } from "../view";

const CLASSES: FaultClass[] = ["clean", "inverted", "anomalous", "unknown"];
const TRUST: Record<FaultClass, string> = { clean: "good", inverted: "care", anomalous: "bad", unknown: "quiet" };

export class FaultsPanel {
  readonly element: HTMLElement;
  private readonly says = el("p", { class: "says", role: "alert" });
  private readonly train = el("button", { id: "faults-train" }, "Learn");
  private readonly learnt = el("p", { id: "faults-learnt", class: "says", role: "alert" });
  private readonly now = el("p", { id: "fault-now" });
  private readonly grid = el("div", { id: "fault-map", class: "fault-map", role: "img", "aria-label": "Cells by class" });
  private readonly row = el("input", { id: "cell-row", type: "number", min: 0, required: true, value: 0 });
  private readonly column = el("input", { id: "cell-column", type: "number", min: 0, required: true, value: 0 });
  private readonly class = el("select", { id: "cell-class" }, ...CLASSES.map((name) => el("option", { value: name }, name)));
  private readonly last = el("input", { id: "faults-last", type: "number", min: 10, max: 300, value: 120 });
  private readonly labels = new Table("fault-labels", "Labels of this frame", [["Sensor"], ["Label", "word"], ["Cause", "word"], ["Distance, mm"], ["Repair", "word"]]);
  private readonly known: HTMLElement;
  private drawn: FaultMap | null = null;
  private winner: number | null = null;

  constructor(private readonly context: Context) {
    const { link } = context;
    const name = el("form", { class: "row" },
      el("label", {}, "Row ", this.row), el("label", {}, "Column ", this.column), el("label", {}, "is ", this.class),
      el("button", { id: "name-cell" }, "Name this cell"));
    name.addEventListener("submit", acting(this.says, () => link.request({
      type: "faults.name_cell", row: Number(this.row.value), column: Number(this.column.value), class: this.class.value as FaultClass,
    })));
    const train = el("form", { class: "row" }, el("label", {}, "Learn the map from the last ", this.last, " s"), this.train);
    train.addEventListener("submit", acting(this.learnt, () => link.request({ type: "faults.train", last_s: Number(this.last.value) })));
    const legend = el("p", { class: "quiet" }, ...CLASSES.flatMap((name) => [el("span", { class: `cell ${name}` }), ` ${name}  `]), "outlined: now");
    this.grid.addEventListener("click", ({ target }) => this.choose(target as HTMLElement));
    this.known = el("div", {}, this.now, this.grid, legend, name, this.labels.element);
    this.element = el("section", { "aria-labelledby": "fault-map-title" }, el("h2", { id: "fault-map-title" }, "Fault map"), this.known, this.says, train, this.learnt);
  }

  draw(): void {
    const { faultMap, sensors, hello, status, jobs } = this.context.model;
    const job = jobs?.jobs.filter(({ kind }) => kind === "faults.train").at(-1);
    this.train.disabled = hello?.role !== "operate" || !!status?.replay || job?.state === "running";
    if (job?.message) setText(this.learnt, job.message);
    this.learnt.className = `says ${job?.state === "done" ? "good" : ""}`;
    this.known.hidden = faultMap === null;
    if (!faultMap) return;
    if (this.drawn !== faultMap) this.drawCells(faultMap);
    const fault = sensors?.fault;
    const cell = fault?.cell ?? null;
    if (cell !== this.winner) {
      if (this.winner !== null) this.grid.children[this.winner]?.classList.remove("winner");
      if (cell !== null) this.grid.children[cell]?.classList.add("winner");
      this.winner = cell;
    }
    setText(this.now, fault
      ? `This frame is ${fault.label}${fault.cause === null ? "" : `: ${spoken(fault.cause)}`}; ${num(fault.distance, 3)} from its cell (mostly below ${num(faultMap.usual_distance, 3)}). Revision ${faultMap.revision}.`
      : "No frame yet.");
    this.now.className = fault ? TRUST[fault.label] : "quiet";
    this.labels.fill((sensors?.sensors ?? []).flatMap(({ name, fault }): Cell[][] => fault ? [[
      [name], [fault.label, `word ${TRUST[fault.label]}`], [fault.cause === null ? "" : spoken(fault.cause), "word"],
      [num(fault.distance_m == null ? null : fault.distance_m * 1000, 0)], [fault.repair ?? "", "word"],
    ]] : []));
  }

  private drawCells(map: FaultMap): void {
    this.drawn = map;
    this.winner = null;
    this.grid.style.gridTemplateColumns = `repeat(${map.columns}, 1fr)`;
    this.grid.replaceChildren(...map.cells.map((name, at) =>
      el("span", { class: `cell ${name}`, title: `row ${Math.floor(at / map.columns)}, column ${at % map.columns}: ${name}` })));
    this.row.max = String(map.rows - 1);
    this.column.max = String(map.columns - 1);
  }

  private choose(target: HTMLElement): void {
    const at = [...this.grid.children].indexOf(target);
    if (at < 0 || !this.drawn) return;
    this.row.value = String(Math.floor(at / this.drawn.columns));
    this.column.value = String(at % this.drawn.columns);
    this.class.value = this.drawn.cells[at]!;
  }
}
