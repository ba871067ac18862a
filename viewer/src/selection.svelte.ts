// The sensor that is looked at: in the picture, in tables and in curves alike.

class Selection {
  /** By name; null: none. */
  sensor = $state<string | null>(null);

  toggle(sensor: string): void {
    this.sensor = this.sensor === sensor ? null : sensor;
  }
}

export const selection = new Selection();
