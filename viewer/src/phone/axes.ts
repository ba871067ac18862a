// Which axes and signs this browser has, found by what the phone measures and not by the browser's name.

import { IDENTITY, type Mat3, type Quat, type Vec3, apply, cross, dot, norm, scale, upOf } from "./vectors";

/** From what the browser says to the axes of the phone: x to the right of the screen, y to its top, z out of it. */
export type Axes = { acceleration: Mat3; gyro: Mat3 };

const KEY = "posed.phone.axes";
const INVERTED: Mat3 = [[-1, 0, 0], [0, -1, 0], [0, 0, -1]];
/** An axis is one if it has at least this share of a vector: 35 degrees off at most. */
const SHARE = 0.8;

/** As the specification has them, until something else was found on this phone. */
export function keptAxes(): Axes {
  try {
    const kept = JSON.parse(localStorage.getItem(KEY) ?? "null") as Axes | null;
    if (kept?.acceleration.length === 3 && kept.gyro.length === 3) return kept;
  } catch {
    // Something else wrote it.
  }
  return { acceleration: IDENTITY, gyro: IDENTITY };
}

export function keepAxes(axes: Axes): void {
  localStorage.setItem(KEY, JSON.stringify(axes));
}

/** The axis that a vector points along; null where it is between two. */
function axisOf(v: Vec3): Vec3 | null {
  const length = norm(v);
  const axis = v.map((part) => (Math.abs(part) >= SHARE * length ? Math.sign(part) : 0)) as Vec3;
  return length > 0 && norm(axis) === 1 ? axis : null;
}

/**
 * From two directions that were measured where two of the phone's own axes were expected, `first` and `second`: by number, 0 to 2.
 * Null where they are no axes. All three inverted is a sign, not a turn.
 */
function axesFrom(first: [axis: 0 | 1 | 2, measured: Vec3], second: [axis: 0 | 1 | 2, measured: Vec3]): Mat3 | null {
  const [one, two] = [axisOf(first[1]), axisOf(second[1])];
  if (!one || !two || dot(one, two) !== 0) return null;
  const isInverted = one.every((part) => part <= 0) && two.every((part) => part <= 0);
  const sign = isInverted ? -1 : 1;
  const rows: (Vec3 | undefined)[] = [undefined, undefined, undefined];
  [rows[first[0]], rows[second[0]]] = [scale(sign, one), scale(sign, two)];
  const third = [0, 1, 2].find((at) => !rows[at])!;
  rows[third] = cross(rows[(third + 1) % 3]!, rows[(third + 2) % 3]!);
  return rows.map((row) => scale(sign, row!)) as Mat3;
}

/** What was measured in the guided test, as the browser says it. */
export type Test = {
  /** Acceleration at rest: on the table with the screen up; upright. */
  flat: Vec3;
  upright: Vec3;
  /** Angle turned while it was stood up, and while it was turned left on the table by a quarter. */
  raised: Vec3;
  turned: Vec3;
};

/** The axes that explain a test; null where none do. */
export function axesOf({ flat, upright, raised, turned }: Test): Axes | null {
  const acceleration = axesFrom([2, flat], [1, upright]);
  const gyro = axesFrom([0, raised], [2, turned]);
  return acceleration && gyro ? { acceleration, gyro } : null;
}

export const isAsSpecified = ({ acceleration, gyro }: Axes): boolean => [acceleration, gyro].every((axes) => JSON.stringify(axes) === JSON.stringify(IDENTITY));

/** At rest this many times the acceleration contradicts what the browser says of the orientation: its sign is the other one. */
const OCCASIONS = 3;
/** Time at rest of an occasion, s, and how slow that is, rad/s. */
const [REST_S, REST_RAD_S] = [0.5, 0.035];

/** Compares acceleration with orientation whenever the phone is at rest. */
export class SignWatch {
  private since_s: number | null = null;
  private against = 0;
  private with = 0;

  /** Axes with another sign, where it was found to be wrong; null: as they are. */
  look(t_s: number, gyro: Vec3, acceleration: Vec3, q: Quat | null, axes: Axes): Axes | null {
    if (!q || norm(gyro) > REST_RAD_S) {
      this.since_s = null;
      return null;
    }
    this.since_s ??= t_s;
    if (t_s - this.since_s < REST_S) return null;
    this.since_s = t_s;
    if (dot(acceleration, upOf(q)) < 0) this.against++;
    else this.with++;
    if (this.against < OCCASIONS || this.with > 0) return null;
    this.against = 0;
    return { ...axes, acceleration: axes.acceleration.map((row) => apply(INVERTED, row)) as Mat3 };
  }
}
