// One channel of a recording.

import { lowerBound } from "../search";

export interface Track {
  channel: string;
  /** From its beginning. */
  t_s: number[];
  values: (number | null)[];
}

/** The value at a time, between the two rows beside it; nothing outside, in gaps and where one of them has none. */
export function valueAt({ t_s, values }: Track, t: number): number | null {
  if (t_s.length < 2 || t < t_s[0]! || t > t_s.at(-1)!) return null;
  // At the last row the two are the last two.
  const high = Math.min(lowerBound(t_s.length, (i) => t_s[i]! <= t), t_s.length - 1);
  const low = high - 1;
  const [before, after] = [values[low], values[high]];
  if (before == null || after == null) return null;
  const span = t_s[high]! - t_s[low]!;
  return span > 0 ? before + ((after - before) * (t - t_s[low]!)) / span : before;
}
