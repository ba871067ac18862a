// What happens in the recording that is played.

import { link, live, model } from "../page.svelte";
import type { Digest, LabelSpan } from "../protocol";
import { type Item, type Lane, lanesOf } from "./lanes";

class Happenings {
  digest = $state.raw<Digest | null>(null);
  /** Nobody has looked yet what happens in it. */
  unknown = $state(false);
  /** What somebody has said that it shows. */
  labels = $state.raw<LabelSpan[]>([]);
  lanes = $state.raw<Lane[]>([]);
  private name: string | null = null;
  private job = NaN;

  constructor() {
    model.listen((message) => {
      if (message.type === "hello") this.name = null;
      if (message.type === "status") this.open(message.replay?.name ?? null);
      if (message.type === "jobs" && message.jobs.some(({ job, state }) => job === this.job && state !== "running")) {
        this.job = NaN;
        this.ask(false).catch(() => {});
      }
    });
    // What came before this was made.
    this.open(live.status?.replay?.name ?? null);
  }

  private open(name: string | null): void {
    if (name === null || name === this.name) return;
    this.name = name;
    this.set(null);
    this.ask(false).catch(() => {});
  }

  /** Has it found out, by a job. */
  make(): Promise<void> {
    return this.ask(true);
  }

  /** Says what it shows for a while; nothing: nothing is said of it any more. */
  async say(from_s: number, to_s: number, label: string): Promise<void> {
    const { name } = this;
    if (name === null) return;
    const { labels } = await link.request({ type: "replay.label", name, from_s, to_s, label });
    if (name === this.name) this.hear(labels);
  }

  /** The job that finds it out; null where none runs. */
  get making() {
    return live.jobs?.jobs.find(({ kind, state }) => kind === "library.digest" && state === "running") ?? null;
  }

  /** The first mark after a time, or the last before it; null where there is none. */
  mark(from_s: number, direction: 1 | -1): Item | null {
    const marks = this.lanes.find(({ name }) => name === "marks")?.items ?? [];
    // What somebody stands on is not the next one.
    const apart_s = 0.05;
    return (direction > 0 ? marks.find(({ from_s: t_s }) => t_s > from_s + apart_s) : marks.filter(({ from_s: t_s }) => t_s < from_s - apart_s).at(-1)) ?? null;
  }

  private async ask(make: boolean): Promise<void> {
    const { name } = this;
    if (name === null) return;
    const answer = await link.request(make ? { type: "library.digest", name, make } : { type: "library.digest", name });
    if (name !== this.name) return;
    if ("job" in answer) this.job = answer.job;
    else if ("digest" in answer) {
      this.set(answer.digest);
      const { labels } = await link.request({ type: "replay.labels", name });
      if (name === this.name) this.hear(labels);
    } else this.unknown = true;
  }

  private set(digest: Digest | null): void {
    this.digest = digest;
    this.unknown = false;
    this.hear([]);
  }

  private hear(labels: LabelSpan[]): void {
    this.labels = labels;
    this.lanes = this.digest ? lanesOf(this.digest, labels) : [];
  }
}

export const happenings = new Happenings();
