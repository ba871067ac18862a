// From the phone's motion to the stage: permission, axes, connection, and a screen that stays awake.

import { type Axes, SignWatch, isAsSpecified, keepAxes, keptAxes } from "./axes";
import { Guide } from "./guide.svelte";
import * as identity from "./identity";
import { Link, type LinkState, type Thought } from "./link";
import { type Reading, type Refusal, measure } from "./motion";
import { apply } from "./vectors";

/** Beyond so many samples a second nothing is gained: browsers give 60. */
const RATE_HZ = 60;
/** How long it shows itself to who looks for it, ms. */
const BLINK_MS = 3000;

class Sender {
  linkState = $state<LinkState>("idle");
  why = $state("");
  thought = $state.raw<Thought | null>(null);
  refusal = $state<Refusal | null>(null);
  started = $state(false);
  name = $state(identity.name());
  /** The screen may go dark. */
  sleeps = $state(false);
  hasOrientation = $state(false);
  /** The automatic check has corrected the sign. */
  signFound = $state(false);
  readonly guide = new Guide();
  /** Somebody looks for this phone. */
  blinks = $state(false);
  private blinking: ReturnType<typeof setTimeout> | undefined;
  private axes: Axes = keptAxes();
  private readonly signs = new SignWatch();
  private readonly token = identity.token();
  private readonly id = identity.id();
  private measuring: { stop: () => void } | null = null;
  private lock: WakeLockSentinel | null = null;
  private readonly link = new Link(
    () => ({
      id: this.id, name: this.name, sw: isAsSpecified(this.axes) ? "posed phone 1" : "posed phone 1, axes corrected", rate: RATE_HZ, unit: "us", bits: 0, sensors: [{ s: 0 }],
      caps: ["gyro", "acc", "ori"], north: false, src: "browser",
    }),
    () => this.token,
    (state, why) => ([this.linkState, this.why] = [state, why]),
    (thought) => (this.thought = thought),
    () => this.blink(),
  );

  constructor() {
    document.addEventListener("visibilitychange", () => this.visible(!document.hidden));
    addEventListener("pagehide", () => this.visible(false));
  }

  async start(): Promise<void> {
    this.measuring?.stop();
    // First of all: it has to happen in the handler of the press.
    const found = await measure((reading) => this.take(reading));
    if (typeof found === "string") {
      this.refusal = found;
      return;
    }
    [this.measuring, this.refusal, this.started] = [found, null, true];
    this.link.open();
    await this.wake();
  }

  stop(): void {
    this.measuring?.stop();
    this.measuring = null;
    this.started = false;
    this.guide.cancel();
    this.link.close("stopped");
    void this.lock?.release();
  }

  private blink(): void {
    this.blinks = true;
    clearTimeout(this.blinking);
    this.blinking = setTimeout(() => (this.blinks = false), BLINK_MS);
  }

  rename(name: string): void {
    this.name = name.trim();
    identity.rename(this.name);
    this.link.greet();
  }

  /** What the guided test has found is used from now on. */
  private correct(axes: Axes): void {
    this.axes = axes;
    keepAxes(axes);
    this.link.greet();
  }

  private take(reading: Reading): void {
    this.guide.look(reading);
    const { verdict } = this.guide;
    if (verdict !== null && verdict !== "unclear" && JSON.stringify(verdict) !== JSON.stringify(this.axes)) this.correct(verdict);
    const gyro = apply(this.axes.gyro, reading.gyro);
    const acceleration = apply(this.axes.acceleration, reading.acceleration);
    const other = this.signs.look(reading.t_us * 1e-6, gyro, acceleration, reading.q, this.axes);
    if (other !== null) {
      this.signFound = true;
      this.correct(other);
    }
    this.hasOrientation = reading.q !== null;
    this.link.send(reading.t_us, gyro, acceleration, reading.q);
  }

  private visible(is: boolean): void {
    if (!this.started) return;
    if (is) {
      this.link.open();
      void this.wake();
    } else this.link.close("page hidden");
  }

  private async wake(): Promise<void> {
    try {
      this.lock = await navigator.wakeLock.request("screen");
      this.sleeps = false;
    } catch {
      this.sleeps = true;
    }
  }
}

export const sender = new Sender();
