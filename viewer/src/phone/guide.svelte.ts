// The guided test: flat on the table, upright, flat again, turned left; half a minute.

import { type Axes, axesOf } from "./axes";
import type { Reading } from "./motion";
import { type Vec3, add, angle, norm, scale } from "./vectors";

export const STEPS = ["flat", "upright", "down", "turn"] as const;
export type GuideStep = (typeof STEPS)[number];

/** At rest: slower than this for so long, rad/s and s; a step lasts at least as long as its sentence is read, s. */
const [SLOW_RAD_S, REST_S, READ_S] = [0.06, 0.8, 1.5];
/** Another position than the one before, and the same again, rad. */
const [OTHER_RAD, SAME_RAD] = [1, 0.5];
/** Turned far enough to know about which axis, rad. */
const TURNED_RAD = 0.8;
/** Nobody does it any more, s. */
const GIVEN_UP_S = 90;

export class Guide {
  step = $state<GuideStep | null>(null);
  /** What came of it last; `unclear`: no axes explain it. */
  verdict = $state<Axes | "unclear" | null>(null);
  private since_s = 0;
  private rest_s: number | null = null;
  private begun_s: number | null = null;
  private before_us = 0;
  private turned: Vec3 = [0, 0, 0];
  private flat: Vec3 = [0, 0, 0];
  private upright: Vec3 = [0, 0, 0];
  private raised: Vec3 = [0, 0, 0];

  begin(): void {
    this.verdict = null;
    [this.begun_s, this.rest_s] = [null, null];
    this.step = "flat";
  }

  cancel(): void {
    this.step = null;
  }

  /** Takes what the browser says, uncorrected. */
  look({ t_us, gyro, acceleration }: Reading): void {
    if (this.step === null) return;
    const t_s = t_us * 1e-6;
    if (this.begun_s === null) [this.begun_s, this.since_s, this.before_us] = [t_s, t_s, t_us];
    if (t_s - this.begun_s > GIVEN_UP_S) return this.end("unclear");
    const passed_s = Math.min(0.2, Math.max(0, (t_us - this.before_us) * 1e-6));
    this.before_us = t_us;
    this.turned = add(this.turned, scale(passed_s, gyro));
    if (norm(gyro) > SLOW_RAD_S) this.rest_s = null;
    else this.rest_s ??= t_s;
    const rests = this.rest_s !== null && t_s - this.rest_s >= REST_S && t_s - this.since_s >= READ_S;
    if (rests) this.rested(t_s, acceleration);
  }

  private rested(t_s: number, acceleration: Vec3): void {
    switch (this.step) {
      case "flat":
        this.flat = acceleration;
        return this.next("upright", t_s);
      case "upright":
        if (angle(acceleration, this.flat) < OTHER_RAD) return;
        [this.upright, this.raised] = [acceleration, this.turned];
        return this.next("down", t_s);
      case "down":
        if (angle(acceleration, this.flat) > SAME_RAD) return;
        return this.next("turn", t_s);
      default:
        if (norm(this.turned) < TURNED_RAD) return;
        return this.end(axesOf({ flat: this.flat, upright: this.upright, raised: this.raised, turned: this.turned }) ?? "unclear");
    }
  }

  private next(step: GuideStep, t_s: number): void {
    [this.step, this.since_s, this.rest_s, this.turned] = [step, t_s, null, [0, 0, 0]];
  }

  private end(verdict: Axes | "unclear"): void {
    this.step = null;
    this.verdict = verdict;
  }
}
