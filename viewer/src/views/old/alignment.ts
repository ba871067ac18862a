// Alignment of the stage, under *Calibrate & record*: how the transmitter stands in the room, and how an IMU sits on a magnetic sensor.

import { acting, el, num, prompt, setText } from "../dom";
import type { Job } from "../protocol";
import type { Context } from "../view";

type Point = { name: string; position_m: [number, number, number] };
type Pose = { position_m: number[]; orientation_wxyz: number[] };
/** What a job of `stage.align` found. */
type Result = {
  transmitter: Pose;
  imu?: { quat_wxyz: number[]; offset_m: number[]; clock_offset_ms: number };
};

const list = (values: number[], digits: number) => `[${values.map((value) => num(value, digits)).join(", ")}]`;

export class Alignment {
  readonly element: HTMLElement;
  private readonly says = el("p", { class: "says", role: "alert" });
  private readonly sensor = el("select", { id: "align-sensor", "aria-label": "Magnetic sensor" }, el("option", { value: "" }, "the one with an IMU"));
  private readonly name = el("input", { id: "align-name", required: true, size: 10, placeholder: "name" });
  private readonly place = [0, 1, 2].map((axis) =>
    el("input", { type: "number", step: "any", required: true, placeholder: "xyz"[axis]!, id: `align-${"xyz"[axis]}`, "aria-label": `${"xyz"[axis]} of the point, m` }));
  private readonly points = el("ul", { id: "align-points", "aria-label": "Surveyed points of the room" });
  private readonly begin = el("button", { id: "align", class: "primary" }, "Align the stage");
  private readonly prompt = el("p", { id: "align-prompt", class: "sentence", role: "status" });
  private readonly keys = el("pre", { id: "align-keys", hidden: true, tabindex: 0 });
  private anchors: Point[] = [];
  private named = "";

  constructor(private readonly context: Context) {
    const { link } = context;
    const add = el("form", { class: "row" }, el("span", {}, "Surveyed point, room, m:"), this.name, ...this.place,
      el("button", { id: "align-add" }, "Add"));
    add.addEventListener("submit", acting(this.says, async () => {
      const [x, y, z] = this.place.map((input) => input.valueAsNumber);
      this.anchors.push({ name: this.name.value.trim(), position_m: [x!, y!, z!] });
      add.reset();
      this.drawPoints();
    }));
    this.begin.addEventListener("click", acting(this.says, () => link.request({
      type: "stage.align", anchors: this.anchors, ...(this.sensor.value === "" ? {} : { sensor: this.sensor.value }),
    })));
    this.element = el("section", {}, el("h2", {}, "Transmitter and IMU"),
      el("div", { class: "row" }, el("label", {}, "Sensor ", this.sensor), this.begin),
      add, this.points, this.says, this.prompt, this.keys);
  }

  draw(jobs: Job[], operates: boolean): void {
    const names = this.context.model.hello?.sensors.map(({ name }) => name) ?? [];
    if (names.join() !== this.named) {
      this.named = names.join();
      this.sensor.replaceChildren(el("option", { value: "" }, "the one with an IMU"), ...names.map((name) => el("option", { value: name }, name)));
    }
    const job = jobs.filter(({ kind }) => kind === "stage.align").at(-1);
    this.begin.disabled = !operates || job?.state === "running";
    prompt(this.prompt, job, "Finds how the transmitter stands and how an IMU sits on its sensor: turn the sensor in your hand, or hold it at surveyed points.");
    const result = job?.state === "done" ? job.result as Result | null | undefined : null;
    this.keys.hidden = !result;
    if (result) setText(this.keys, keys(result));
  }

  private drawPoints(): void {
    this.points.replaceChildren(...this.anchors.map((point, at) => el("li", {},
      `${point.name}: ${list(point.position_m, 3)} `,
      el("button", { "aria-label": `Remove ${point.name}`, onclick: () => {
        this.anchors.splice(at, 1);
        this.drawPoints();
      } }, "Remove"))));
  }
}

/** What to write into the stage file. */
function keys({ transmitter, imu }: Result): string {
  const stage = `[transmitter.pose_in_room]\nposition_m = ${list(transmitter.position_m, 4)}\norientation_wxyz = ${list(transmitter.orientation_wxyz, 6)}\n`;
  if (!imu) return stage;
  return `${stage}\n# in the table \`imu\` of the magnetic [[sensor]]\nquat_wxyz = ${list(imu.quat_wxyz, 6)}\noffset_m = ${list(imu.offset_m, 4)}\nclock_offset_ms = ${num(imu.clock_offset_ms, 2)}\n`;
}
