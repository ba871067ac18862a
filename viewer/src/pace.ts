// How many frames a second this browser draws: what it does not draw it need not be sent.

/** Time over which frames are counted, ms; a longer pause between two frames was a hidden tab. */
const LOOK_MS = 2000;
const PAUSE_MS = 500;
/** Frames per second that a screen can use, and that one gets which draws fewer than `SLOW_HZ`, until it draws more than `FAST_HZ`. */
export const DRAWN_HZ = 60;
const SPARED_HZ = 30;
const SLOW_HZ = 25;
const FAST_HZ = 40;

export class Pace {
  private since_ms = NaN;
  private last_ms = NaN;
  private frames = 0;
  private rate_hz = DRAWN_HZ;

  /** `tell` hears what is to be sent a second, `count` what was drawn. */
  constructor(private readonly tell: (rate_hz: number) => void, private readonly count: (drawn_hz: number) => void) {}

  /** One more was drawn. */
  frame(now_ms: number): void {
    if (!(now_ms - this.last_ms < PAUSE_MS)) [this.since_ms, this.frames] = [now_ms, 0];
    this.last_ms = now_ms;
    this.frames++;
    const span_ms = now_ms - this.since_ms;
    if (span_ms < LOOK_MS) return;
    const drawn_hz = (1000 * this.frames) / span_ms;
    this.count(drawn_hz);
    [this.since_ms, this.frames] = [now_ms, 0];
    const rate_hz = drawn_hz < SLOW_HZ ? SPARED_HZ : drawn_hz > FAST_HZ ? DRAWN_HZ : this.rate_hz;
    if (rate_hz !== this.rate_hz) this.tell((this.rate_hz = rate_hz));
  }
}
