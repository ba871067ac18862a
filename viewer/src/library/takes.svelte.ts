// The recordings of the folder, and those in the bin.

import { link, live, model } from "../page.svelte";
import type { LibraryTake } from "../protocol";

class Library {
  takes = $state.raw<LibraryTake[]>([]);
  bin = $state.raw<LibraryTake[]>([]);
  recording = $state<string | null>(null);
  /** Asked once at least. */
  known = $state(false);
  private running = new Set<number>();

  constructor() {
    model.listen((message) => {
      if (!this.known) return;
      // What a job has made or ended is new in the folder.
      if (message.type === "jobs") {
        const running = new Set(message.jobs.filter(({ state, kind }) => state === "running" && (kind === "record.start" || kind === "library.digest")).map(({ job }) => job));
        if ([...this.running].some((job) => !running.has(job))) this.refresh().catch(() => {});
        this.running = running;
      }
      if (message.type === "status" && (message.recording?.name ?? null) !== (live.status?.recording?.name ?? null)) this.refresh().catch(() => {});
    });
  }

  get names(): string[] {
    return this.takes.filter(({ unreadable }) => unreadable === null).map(({ name }) => name);
  }

  async refresh(): Promise<void> {
    const { takes, recording } = await link.request({ type: "library.list" });
    const bin = await link.request({ type: "library.list", bin: true });
    [this.takes, this.recording, this.bin, this.known] = [takes, recording, bin.takes, true];
  }
}

export const library = new Library();
