// What happens in a recording, by lanes, each in order of time; and what of a lane is seen.

import type { Digest, LabelSpan } from "../protocol";
import { lowerBound } from "../search";
import { words } from "../text/index.svelte";
import type { Window } from "./window";

export const LANES = ["marks", "labels", "segments", "repetitions", "faults", "key_poses"] as const;
export type LaneName = (typeof LANES)[number];

/** Something that happened; a moment ends when it begins. `kind` tells what is alike, for its colour. */
export type Item = { lane: LaneName; from_s: number; to_s: number; says: string; kind: number };
/** The longest item bounds how far before the window one begins that reaches into it, s. */
export type Lane = { name: LaneName; items: Item[]; longest_s: number };

/** Lanes with something in them, in their order. */
export function lanesOf(digest: Digest, labels: readonly LabelSpan[]): Lane[] {
  const kinds: string[] = [];
  const kind = (label: string) => (kinds.includes(label) ? kinds.indexOf(label) : kinds.push(label) - 1);
  const all: Record<LaneName, Item[]> = {
    marks: digest.marks.map(({ t_s, label }) => ({ lane: "marks", from_s: t_s, to_s: t_s, says: label, kind: 0 })),
    // What somebody said and what a network names the same has the same colour.
    labels: labels.map(({ label, from_s, to_s }) => ({ lane: "labels", from_s, to_s, says: label, kind: kind(label) })),
    segments: digest.segments.map(({ label, from_s, to_s }) => ({ lane: "segments", from_s, to_s, says: label, kind: kind(label) })),
    repetitions: digest.repetitions.map(({ exercise, from_s, t_s, counted }) => ({ lane: "repetitions", from_s, to_s: t_s, says: exercise, kind: counted ? 0 : 1 })),
    faults: digest.faults.map(({ sensor, fault, from_s, to_s }) => ({ lane: "faults", from_s, to_s, says: `${sensor}: ${words.text.daemon.term(fault)}`, kind: 0 })),
    key_poses: digest.key_poses.map(({ sensor, t_s }) => ({ lane: "key_poses", from_s: t_s, to_s: t_s, says: sensor, kind: 0 })),
  };
  return LANES.filter((name) => all[name].length > 0).map((name) => {
    const items = all[name].sort((a, b) => a.from_s - b.from_s);
    return { name, items, longest_s: items.reduce((longest, { from_s, to_s }) => Math.max(longest, to_s - from_s), 0) };
  });
}

/** Place of the first item that begins at a time or later. */
export function firstFrom(items: readonly Item[], t_s: number): number {
  return lowerBound(items.length, (i) => items[i]!.from_s < t_s);
}

/** Those that reach into a window. */
export function* seen({ items, longest_s }: Lane, { from_s, to_s }: Window): Generator<Item> {
  for (let i = firstFrom(items, from_s - longest_s); i < items.length && items[i]!.from_s <= to_s; i++) {
    if (items[i]!.to_s >= from_s) yield items[i]!;
  }
}

/** The item at a time, or the nearest beginning within a reach of it. */
export function itemAt(lane: Lane, t_s: number, reach_s: number): Item | null {
  let [best, away_s]: [Item | null, number] = [null, reach_s];
  for (const item of seen(lane, { from_s: t_s - reach_s, to_s: t_s + reach_s })) {
    const off_s = Math.max(item.from_s - t_s, t_s - item.to_s, 0);
    // Of several that cover it the one that began last.
    if (off_s <= away_s) [best, away_s] = [item, off_s];
  }
  return best;
}
