// Calibration of single IMUs, under *Calibrate & record*: place the unit in all directions, see which were held, what it came to.

import { acting, el, num, prompt, setText } from "../dom";
import type { Job } from "../protocol";
import type { Context } from "../view";

/** What a job of `imu.calibrate` says while it runs, and in the end. */
type Result = {
  directions: number; wanted: number; held: string[]; missing: string[]; field: number | null; file?: string;
  intrinsics?: {
    gyro_bias_rad_s: number[]; gyro_bias_sigma_rad_s: number; accel_bias_m_s2: number[]; accel_scale: number[];
    accel_residual_m_s2: number; mag: { offset: number[]; residual: number } | null;
  };
};

/** Drivers whose units send angular velocity and specific force. */
const INERTIAL = ["xbus", "x-imu3"];
const SIDES = ["+x", "-x", "+y", "-y", "+z", "-z"];
const DEGREES = 180 / Math.PI;

const list = (values: number[], digits: number, scale = 1) => values.map((value) => num(scale * value, digits)).join(", ");

export class Units {
  readonly element: HTMLElement;
  private readonly says = el("p", { class: "says", role: "alert" });
  private readonly sensor = el("select", { id: "unit-sensor", "aria-label": "IMU" });
  private readonly begin = el("button", { id: "unit-calibrate", class: "primary" }, "Calibrate the IMU");
  private readonly prompt = el("p", { id: "unit-prompt", class: "sentence", role: "status" });
  private readonly sides = SIDES.map((side) => el("li", { id: `unit-${side}` }));
  private readonly run: HTMLElement;
  private readonly directions = el("progress", { id: "unit-directions", max: 1, "aria-label": "share of the directions" });
  private readonly field = el("progress", { id: "unit-field", max: 1, "aria-label": "share of the field's directions" });
  private readonly fieldLabel = el("label", {}, "field seen ", this.field);
  private readonly table = el("tbody", { id: "unit-figures" });
  private readonly figures = el("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Intrinsics of the IMU", hidden: true }, el("table", {}, this.table));
  private named = "";

  constructor(private readonly context: Context) {
    this.begin.addEventListener("click", acting(this.says, () =>
      context.link.request({ type: "imu.calibrate", sensor: this.sensor.value })));
    this.run = el("div", { hidden: true },
      el("div", { class: "row" }, el("label", {}, "directions held ", this.directions), this.fieldLabel),
      el("ul", { id: "unit-sides", class: "row", "aria-label": "Sides that were up" }, ...this.sides));
    this.element = el("section", { hidden: true }, el("h2", {}, "IMU"),
      el("div", { class: "row" }, el("label", {}, "Unit of the sensor ", this.sensor), this.begin),
      this.says, this.prompt, this.run, this.figures);
  }

  draw(jobs: Job[], operates: boolean): void {
    const { hello, status } = this.context.model;
    const inertial = new Set(status?.devices.filter(({ driver }) => INERTIAL.includes(driver)).map(({ name }) => name));
    const names = hello?.sensors.filter(({ device }) => inertial.has(device)).map(({ name }) => name) ?? [];
    this.element.hidden = names.length === 0 || !!status?.replay;
    if (this.element.hidden) return;
    if (names.join("\n") !== this.named) {
      this.named = names.join("\n");
      this.sensor.replaceChildren(...names.map((name) => el("option", { value: name }, name)));
    }
    const job = jobs.filter(({ kind }) => kind === "imu.calibrate").at(-1);
    const running = job?.state === "running";
    this.begin.disabled = !operates || running;
    prompt(this.prompt, job, "Finds the biases and scales of one unit, and its hard-iron and soft-iron distortion: place it on its sides, edges and corners, two seconds each.");
    const result = job?.result as Result | null | undefined;
    this.run.hidden = !result || job?.state === "done";
    this.figures.hidden = !result?.intrinsics || running;
    if (!result) return;
    this.directions.value = result.directions / result.wanted;
    this.fieldLabel.hidden = result.field === null;
    this.field.value = result.field ?? 0;
    SIDES.forEach((side, index) => {
      const held = result.held.includes(side);
      const item = this.sides[index]!;
      setText(item, `${side.replace("-", "−")} up: ${held ? "held" : "missing"}`);
      item.className = held ? "good" : "care";
    });
    if (!this.figures.hidden) this.drawFigures(result);
  }

  private drawFigures({ intrinsics, file }: Result): void {
    if (!intrinsics) return;
    const { gyro_bias_rad_s, gyro_bias_sigma_rad_s, accel_bias_m_s2, accel_scale, accel_residual_m_s2, mag } = intrinsics;
    const rows: [string, string, string][] = [
      ["gyro bias, deg/s", list(gyro_bias_rad_s, 3, DEGREES), `differs by ${num(DEGREES * gyro_bias_sigma_rad_s, 3)} between the rests`],
      ["accelerometer bias, m/s²", list(accel_bias_m_s2, 3), `${num(accel_residual_m_s2, 3)} m/s² of gravity are left`],
      ["accelerometer scale", list(accel_scale, 4), ""],
    ];
    if (mag) rows.push(["magnetometer offset", list(mag.offset, 3), `${num(100 * mag.residual, 1)} % of the field's length are left`]);
    if (file) rows.push(["kept as", file, ""]);
    this.table.replaceChildren(...rows.map(([name, value, quality]) =>
      el("tr", {}, el("th", { scope: "row" }, name), el("td", {}, value), el("td", {}, quality))));
  }
}
