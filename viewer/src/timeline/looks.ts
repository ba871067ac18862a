// Where everything was at the time that a hand points at: asked for as often as it is answered, the newest wish first.

import type { Look } from "../protocol";

/** Between two requests, ms: a daemon hears fifty a second on average, and other requests want room as well. */
const LEAST_MS = 25;

export class Looks {
  private wanted_s: number | null = null;
  private asking = false;

  constructor(private readonly ask: (t_s: number) => Promise<Look>, private readonly show: (look: Look) => void) {}

  want(t_s: number): void {
    this.wanted_s = t_s;
    if (!this.asking) void this.run();
  }

  /** Nothing that is still under way is shown. */
  stop(): void {
    this.wanted_s = null;
    this.stopped++;
  }
  private stopped = 0;

  private async run(): Promise<void> {
    this.asking = true;
    try {
      while (this.wanted_s !== null) {
        const [t_s, stopped, begun_ms] = [this.wanted_s, this.stopped, performance.now()];
        this.wanted_s = null;
        const look = await this.ask(t_s);
        if (stopped === this.stopped) this.show(look);
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
}
