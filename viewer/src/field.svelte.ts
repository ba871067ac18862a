// What events have said of the field: the map in use, disturbances, a calibration that runs.

import type { FieldMap } from "./model";
import { model } from "./page.svelte";
import type { FieldEventMessage } from "./protocol";

export type Disturbance = Extract<FieldEventMessage, { event: "disturbed" }>;
type Drift = Extract<FieldEventMessage, { event: "drifted" }>;
type Progress = Extract<FieldEventMessage, { event: "calibrating" }>["progress"];
export type Anchor = { name: string; sensor: string; t_start: number; t_end: number; position_m: [number, number, number] };

class Field {
  map = $state.raw<FieldMap | null>(null);
  progress = $state.raw<Progress | null>(null);
  disturbed = $state.raw<Disturbance[]>([]);
  drifted = $state.raw<Drift | null>(null);
  /** Surveyed points that the pole stood on in this run. */
  anchors = $state.raw<Anchor[]>([]);

  take(message: FieldEventMessage): void {
    switch (message.event) {
      case "map_swapped":
        this.map = message;
        this.disturbed = [];
        this.drifted = null;
        break;
      case "disturbed": {
        const same = ({ cause, sensors }: Disturbance) => cause === message.cause && sensors.join() === message.sensors.join();
        const others = this.disturbed.filter((each) => !same(each));
        this.disturbed = message.active ? [...others, message] : others;
        break;
      }
      case "drifted":
        this.drifted = message;
        break;
      case "calibrating":
        if (message.progress.collecting && !this.progress?.collecting) this.anchors = [];
        this.progress = message.progress;
        break;
    }
  }

  /** Another daemon, or the same one anew: what holds comes again. */
  forget(): void {
    this.map = this.progress = this.drifted = null;
    this.disturbed = [];
  }
}

export const field = new Field();
model.listen((message) => {
  if (message.type === "hello") field.forget();
  else if (message.type === "field") field.take(message);
});
