// Which part of a recording the timeline shows, and where a time lies in it.

/** Narrower than this nothing more is seen, s. */
const NARROWEST_S = 0.5;
/** Steps between two labels of the ruler, s. */
const STEPS_S = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200];

/** A part of a recording, stage time, s. */
export type Window = { from_s: number; to_s: number };

export const lengthOf = ({ from_s, to_s }: Window): number => to_s - from_s;

/** The window of the same length, or as long as the recording, that lies within it. */
export function within(window: Window, all: Window): Window {
  const length_s = Math.min(Math.max(lengthOf(window), NARROWEST_S), lengthOf(all));
  const from_s = Math.min(Math.max(window.from_s, all.from_s), all.to_s - length_s);
  return { from_s, to_s: from_s + length_s };
}

/** Closer by a factor, with what lies at a time where it is. */
export function zoomed(window: Window, all: Window, at_s: number, factor: number): Window {
  const length_s = Math.min(Math.max(lengthOf(window) / factor, NARROWEST_S), lengthOf(all));
  const share = lengthOf(window) > 0 ? (at_s - window.from_s) / lengthOf(window) : 0;
  const from_s = at_s - share * length_s;
  return within({ from_s, to_s: from_s + length_s }, all);
}

export function moved(window: Window, all: Window, by_s: number): Window {
  return within({ from_s: window.from_s + by_s, to_s: window.to_s + by_s }, all);
}

/** With a time in it: turned over like a page where it has run out of it. */
export function showing(window: Window, all: Window, t_s: number): Window {
  if (t_s >= window.from_s && t_s <= window.to_s) return window;
  return within({ from_s: t_s, to_s: t_s + lengthOf(window) }, all);
}

/** Times of the ruler's labels, at least `apart_px` apart on `width_px`, counted from the recording's beginning. */
export function ticks(window: Window, begun_s: number, width_px: number, apart_px: number): { step_s: number; times_s: number[] } {
  const least_s = (lengthOf(window) * apart_px) / Math.max(width_px, 1);
  const step_s = STEPS_S.find((step) => step >= least_s) ?? STEPS_S.at(-1)! * Math.ceil(least_s / STEPS_S.at(-1)!);
  const times_s: number[] = [];
  for (let n = Math.ceil((window.from_s - begun_s) / step_s); begun_s + n * step_s <= window.to_s; n++) times_s.push(begun_s + n * step_s);
  return { step_s, times_s };
}
