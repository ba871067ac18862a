// Time to take one's place after a button was pressed.

export class Countdown {
  /** Seconds until it begins; null: nobody waits. */
  left_s = $state<number | null>(null);
  private begin = (): void => {};

  /** For the component that is being made; it ends with it. */
  constructor() {
    $effect(() => {
      if (this.left_s === null) return;
      const timer = setTimeout(() => {
        this.left_s = this.left_s === null || this.left_s <= 1 ? null : this.left_s - 1;
        if (this.left_s === null) this.begin();
      }, 1000);
      return () => clearTimeout(timer);
    });
  }

  /** Begins in so many seconds; at once in none. */
  start(seconds: number, begin: () => void): void {
    if (seconds <= 0) return begin();
    this.begin = begin;
    this.left_s = seconds;
  }

  cancel(): void {
    this.left_s = null;
  }
}
