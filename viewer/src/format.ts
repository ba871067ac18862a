// Numbers as people read them.

/** A number with so many digits, or a dash. */
export function num(value: number | null | undefined, digits: number): string {
  return value === null || value === undefined || !Number.isFinite(value) ? "–" : value.toFixed(digits);
}

/** In thousandths: mm of m, ms of s. */
export function milli(value: number | null | undefined, digits: number): string {
  return num(value == null ? null : 1000 * value, digits);
}

/** `1:02:03`, or `02:03` below an hour. */
export function clock(s: number): string {
  const whole = Math.max(0, Math.floor(s));
  const two = (n: number) => String(n).padStart(2, "0");
  const [h, min] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60];
  return `${h > 0 ? `${h}:` : ""}${two(min)}:${two(whole % 60)}`;
}
