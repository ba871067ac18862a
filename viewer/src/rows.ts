// The last rows of named numbers, oldest overwritten: what curves are drawn from.

export class Rows {
  private readonly width: number;
  private readonly values: Float64Array;
  private next = 0;
  length = 0;

  constructor(readonly names: string[], private readonly capacity: number) {
    this.width = names.length + 1;
    this.values = new Float64Array(capacity * this.width);
  }

  /** Begins a row at a time; what is not `set` is not a number. */
  begin(t_s: number): void {
    const from = this.next * this.width;
    this.values.fill(NaN, from, from + this.width);
    this.values[from] = t_s;
    this.next = (this.next + 1) % this.capacity;
    this.length = Math.min(this.length + 1, this.capacity);
  }

  /** Of the newest row; column 0 is the time, s. */
  set(column: number, value: number | null | undefined): void {
    this.values[this.place(this.length - 1) + column] = value ?? NaN;
  }

  /** Of the newest row, or of the one `back` before it; not a number where there is none. */
  newest(column: number, back = 0): number {
    return back < this.length ? this.values[this.place(this.length - 1 - back) + column]! : NaN;
  }

  /** A column, oldest first. */
  column(index: number): Float64Array {
    const out = new Float64Array(this.length);
    for (let row = 0; row < this.length; row++) out[row] = this.values[this.place(row) + index]!;
    return out;
  }

  clear(): void {
    this.length = 0;
  }

  /** Where row `row` begins, 0 the oldest. */
  private place(row: number): number {
    return ((this.next - this.length + row + this.capacity) % this.capacity) * this.width;
  }
}
