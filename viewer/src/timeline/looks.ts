// Where everything was at the time that a hand points at: asked for as often as it is answered, the newest wish first.

import type { Look } from "../protocol";
import { Moments } from "./between";

/** Between two requests, ms: a daemon hears fifty a second on average, and other requests want room as well. */
const LEAST_MS = 25;
/** So much later the next moment of a recording is shown, s. */
const NEXT_S = 0.22;

export class Looks {
  private moments = new Moments();
  private wanted_s: number | null = null;
  private shown_s = NaN;
  private asking = false;

  constructor(private readonly ask: (t_s: number) => Promise<Look>, private readonly show: (look: Look) => void) {}

  want(t_s: number): void {
    this.wanted_s = t_s;
    this.tell();
    if (!this.asking) void this.run();
  }

  /** Nothing that is still under way is shown. */
  stop(): void {
    this.wanted_s = null;
    this.shown_s = NaN;
  }

  /** Another recording: what was known is of the one before. */
  forget(): void {
    this.stop();
    this.moments = new Moments();
  }

  /** Shows what is known of the time that is wanted. */
  private tell(): void {
    const known = this.wanted_s === null ? null : this.moments.at(this.wanted_s);
    if (!known || known.look.t_s === this.shown_s) return;
    this.shown_s = known.look.t_s;
    this.show(known.look);
  }

  private async run(): Promise<void> {
    this.asking = true;
    try {
      let asked_s = NaN;
      for (let t_s = this.open(); t_s !== null && t_s !== asked_s; t_s = this.open()) {
        const begun_ms = performance.now();
        asked_s = t_s;
        this.moments.keep(await this.ask(t_s), t_s);
        this.tell();
        const spare_ms = LEAST_MS - (performance.now() - begun_ms);
        if (spare_ms > 0) await new Promise((resolve) => setTimeout(resolve, spare_ms));
      }
    } catch {
      // A connection that broke, or a daemon without it: the picture stays as it is.
      this.wanted_s = null;
    } finally {
      this.asking = false;
    }
  }

  /** The time to ask for: what is wanted, then what comes after it; null: nothing would tell more. */
  private open(): number | null {
    if (this.wanted_s === null) return null;
    const known = this.moments.at(this.wanted_s);
    if (!known) return this.wanted_s;
    return known.settled ? null : this.wanted_s + NEXT_S;
  }
}
