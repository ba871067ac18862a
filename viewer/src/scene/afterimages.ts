// Where a person was in the last two seconds: see-through figures, half a second apart.

import { Group } from "three";
import type { FigureMessage } from "../protocol";
import { BodyFigure } from "./body";

const COUNT = 4;
const APART_S = 0.5;

export class Afterimages {
  readonly group = new Group();
  private readonly figures = Array.from({ length: COUNT }, () => new BodyFigure("ghost"));
  private kept: FigureMessage[] = [];

  constructor() {
    this.group.add(...this.figures.map(({ group }) => group));
    this.group.visible = false;
  }

  take(body: FigureMessage): void {
    const last = this.kept.at(-1);
    // Another person, or a replay that went back.
    if (last && (last.name !== body.name || body.t_s < last.t_s)) this.kept = [];
    else if (last && body.t_s < last.t_s + APART_S) return;
    this.kept.push(body);
    // The newest is where the person is.
    if (this.kept.length > COUNT + 1) this.kept.shift();
  }

  draw(height_m: number | null): void {
    this.figures.forEach((figure, i) => {
      const body = this.kept[i];
      if (body && i + 1 < this.kept.length) figure.update(body, height_m);
      else figure.group.visible = false;
    });
  }
}
