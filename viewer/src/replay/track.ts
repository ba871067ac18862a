// One channel of a recording.

export interface Track {
  channel: string;
  /** From its beginning. */
  t_s: number[];
  values: (number | null)[];
}

/** The value at a time, between the two rows beside it; nothing outside, in gaps and where one of them has none. */
export function valueAt({ t_s, values }: Track, t: number): number | null {
  let [low, high] = [0, t_s.length - 1];
  if (high < 1 || t < t_s[0]! || t > t_s[high]!) return null;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (t_s[middle]! <= t) low = middle;
    else high = middle;
  }
  const [before, after] = [values[low], values[high]];
  if (before == null || after == null) return null;
  const span = t_s[high]! - t_s[low]!;
  return span > 0 ? before + ((after - before) * (t - t_s[low]!)) / span : before;
}
