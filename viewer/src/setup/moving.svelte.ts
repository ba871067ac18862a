// Which sensor somebody moves just now: the one that turns fastest, if any does.

import { model } from "../page.svelte";
import type { Quat } from "../protocol";

/** Slower is a hand that trembles, or noise, rad/s. */
const TURNS_RAD_S = 1;

type Seen = { t_s: number; orientation: Quat };

export class Moving {
  /** By name; null: none. */
  sensor = $state<string | null>(null);
  private readonly before = new Map<string, Seen>();

  /** Looks at the newest frame; some times a second are enough. */
  look(): void {
    const frame = model.sensors;
    if (!frame) return;
    let fastest: [sensor: string | null, speed_rad_s: number] = [null, TURNS_RAD_S];
    for (const { name, orientation_wxyz, measured } of frame.sensors) {
      const gyro = measured?.angular_velocity_rad_s;
      let speed_rad_s = gyro ? Math.hypot(...gyro) : 0;
      if (orientation_wxyz) {
        const seen = this.before.get(name);
        if (!gyro && seen && frame.t_s > seen.t_s) speed_rad_s = angle(seen.orientation, orientation_wxyz as Quat) / (frame.t_s - seen.t_s);
        this.before.set(name, { t_s: frame.t_s, orientation: orientation_wxyz as Quat });
      }
      if (speed_rad_s > fastest[1]) fastest = [name, speed_rad_s];
    }
    if (this.sensor !== fastest[0]) this.sensor = fastest[0];
  }
}

/** Between two orientations, rad. */
function angle(a: Quat, b: Quat): number {
  const dot = Math.abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]);
  return 2 * Math.acos(Math.min(1, dot));
}
