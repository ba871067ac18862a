// Health: what each device and sensor does, how long each stage of the flow takes, and what to do next.

import { type Cell, Table, el, num, setText, spoken } from "../dom";
import { type SensorEntry, trustOf } from "../protocol";
import type { Context, View } from "../view";

const LINK_CLASS = { streaming: "good", connecting: "care", silent: "care", failed: "bad" } as const;

/** Sensors whose row is renewed in one frame. */
const ROWS_PER_FRAME = 12;

/** A sensor's state, and what the fault map reports about it. */
function faulty({ state, fault }: SensorEntry): string {
  return !fault || fault.cause === null || fault.cause === "missing" ? state : `${state}: ${fault.label}, ${spoken(fault.cause)}`;
}

function thousandths(value: number | null | undefined, digits: number): string {
  return num(value == null ? null : 1000 * value, digits);
}

export class HealthView implements View {
  readonly id = "health";
  readonly title = "Health";
  readonly element: HTMLElement;
  private readonly sensors = new Table("sensors", "Sensors", [
    ["Sensor"], ["State", "word"], ["Rate, Hz"], ["Age, ms"], ["x, m"], ["y, m"], ["z, m"], ["w"], ["x"], ["y"], ["z"], ["σ, mm"], ["Samples"], ["Lost"],
  ]);
  private readonly devices = new Table("devices", "Devices", [
    ["Device"], ["Driver", "word"], ["Port", "word"], ["State", "word"], ["Rate, Hz"], ["Age, ms"], ["Clock ±, ms"], ["Records"], ["Rejected"], ["Skipped"],
  ]);
  private readonly latency = new Table("latency", "Latency since the last second", [["From where to where"], ["Median, ms"], ["99 %, ms"], ["Longest, ms"]]);
  private readonly frame = el("p", { id: "frame", class: "quiet" });
  private readonly clients = el("p", { class: "quiet" });

  constructor(private readonly context: Context) {
    this.element = el("div", {}, this.devices.element, this.sensors.element, this.frame, this.latency.element, this.clients);
  }

  draw(_now: number, fresh: boolean): void {
    if (!fresh) return;
    this.drawSensors();
    const status = this.context.model.status;
    if (!status) return;
    this.devices.fill(status.devices.map((device): Cell[] => [
      [device.name],
      [device.driver, "word"],
      [device.port, "word"],
      [device.reason ? `${device.state}: ${device.reason}` : device.state, `word reason ${LINK_CLASS[device.state]}`],
      [num(device.rate_hz, 2)],
      [thousandths(device.age_s, 0)],
      [thousandths(device.sigma_t_s, 3)],
      [String(device.records)],
      [String(device.rejected)],
      [String(device.bytes_skipped)],
    ]));
    this.latency.fill(status.latency.map((stage): Cell[] => [
      [stage.stage], [num(stage.p50_ms, 3)], [num(stage.p99_ms, 3)], [num(stage.max_ms, 3)],
    ]));
    setText(this.clients, status.clients === 1 ? "one client: this page" : `${status.clients} clients`);
  }

  /** A few sensors in each frame: fifty at once would take longer than a frame may. */
  private drawSensors(): void {
    const { sensors, status } = this.context.model;
    if (!sensors) return;
    const counts = new Map(status?.sensors.map((sensor) => [sensor.name, sensor]));
    this.sensors.fillSome(sensors.sensors, ROWS_PER_FRAME, (sensor): Cell[] => {
      const count = counts.get(sensor.name);
      const numbers = (values: number[] | null | undefined, n: number, digits: number): Cell[] =>
        Array.from({ length: n }, (_, i) => [num(values?.[i], digits)]);
      return [
        [sensor.name],
        [faulty(sensor), `word ${trustOf(sensor.state)}`],
        [num(count?.rate_hz, 1)],
        [thousandths(count?.age_s, 0)],
        ...numbers(sensor.position_m, 3, 4),
        ...numbers(sensor.orientation_wxyz, 4, 3),
        [thousandths(sensor.sigma_m, 2)],
        [count ? String(count.samples) : "–"],
        [count ? `${count.lost}${count.estimated ? " ~" : ""}` : "–"],
      ];
    });
    const dropped = sensors.dropped ? `, ${sensors.dropped} messages dropped for this page` : "";
    setText(this.frame, `stage time ${sensors.t_s.toFixed(2)} s${dropped}`);
  }
}
