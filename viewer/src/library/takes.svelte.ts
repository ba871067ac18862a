// The recordings of the folder, and those in the bin.

import { Refused } from "../link";
import { link, model } from "../page.svelte";
import type { LibraryTake } from "../protocol";
import { type RemoteTake, remoteTakes } from "./where";

/** Jobs that change what the folder has. */
const KINDS = ["record.start", "library.digest"];

class Library {
  takes = $state.raw<LibraryTake[]>([]);
  bin = $state.raw<LibraryTake[]>([]);
  recording = $state<string | null>(null);
  /** At a hub: what the stage has, which is watched there. Null on a stage's own page. */
  remote = $state.raw<RemoteTake[] | null>(null);
  /** Asked once at least. */
  known = $state(false);
  private running = "";

  constructor() {
    model.listen((message) => {
      if (!this.known || message.type !== "jobs") return;
      // What is being recorded or looked through, and what has come of it, is new in the folder.
      const running = message.jobs.filter(({ state, kind }) => state === "running" && KINDS.includes(kind)).map(({ job }) => job).join();
      if (running !== this.running) this.refresh().catch(() => {});
      this.running = running;
    });
  }

  get names(): string[] {
    return this.takes.filter(({ unreadable }) => unreadable === null).map(({ name }) => name);
  }

  async refresh(): Promise<void> {
    const listed = await link.request({ type: "library.list" }).catch((error: unknown) => {
      if (error instanceof Refused && error.reason === "hub") return null;
      throw error;
    });
    if (listed === null) {
      this.remote = await remoteTakes();
      return;
    }
    const { takes, recording } = listed;
    const bin = await link.request({ type: "library.list", bin: true });
    [this.takes, this.recording, this.bin, this.known] = [takes, recording, bin.takes, true];
  }
}

export const library = new Library();
