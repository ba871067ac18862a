// Moments of a recording that are known, and what lies between two of them: a recording shows itself a few times a second, eyes see sixty.

import type { Look, Quat, Vec3 } from "../protocol";
import { lowerBound } from "../search";

/** Further apart nothing is known of what lies between, s: a recording shows itself five times a second. */
const APART_S = 0.3;
/** What is the same so much later has no next moment near by, s. */
const SAME_S = 0.2;
/** So many are kept: two minutes and more. */
const MOST = 800;

/** Known to be what is shown from its time up to `until_s`. */
type Known = { look: Look; until_s: number };

export class Moments {
  /** In order of time. */
  private known: Known[] = [];

  /** What was shown last at a time. */
  keep(look: Look, at_s: number): void {
    const i = this.place(look.t_s);
    const before = this.known[i];
    if (before?.look.t_s === look.t_s) before.until_s = Math.max(before.until_s, at_s);
    else this.known.splice(i + 1, 0, { look, until_s: Math.max(at_s, look.t_s) });
    // Those furthest from where somebody looks.
    if (this.known.length > MOST) this.known.splice(i < MOST / 2 ? MOST : 0, 1);
  }

  /** Where everything was at a time; null where that has to be asked. `settled`: what comes next is known as well, so that asking would tell no more. */
  at(t_s: number): { look: Look; settled: boolean } | null {
    const i = this.place(t_s);
    const [before, after] = [this.known[i], this.known[i + 1]];
    if (!before) return null;
    if (after && after.look.t_s - before.look.t_s <= APART_S) return { look: between(before.look, after.look, t_s), settled: true };
    return t_s > before.until_s ? null : { look: before.look, settled: before.until_s >= t_s + SAME_S };
  }

  /** Place of the last one at a time or before; -1: none. */
  private place(t_s: number): number {
    return lowerBound(this.known.length, (i) => this.known[i]!.look.t_s <= t_s) - 1;
  }
}

function mixed(a: Vec3, b: Vec3, share: number): Vec3 {
  return [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])];
}

/** The shorter way round; in so short a time nothing turns so far that the way would have to be exact. */
function turned(a: Quat, b: Quat, share: number): Quat {
  const sign = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0 ? -1 : 1;
  const mix = a.map((part, i) => part + share * (sign * b[i]! - part)) as Quat;
  const length = Math.hypot(...mix);
  return mix.map((part) => part / length) as Quat;
}

/** What both know, between them. */
function between(a: Look, b: Look, t_s: number): Look {
  const share = (t_s - a.t_s) / (b.t_s - a.t_s);
  type Placed = { name: string; position_m: Vec3 | null; orientation_wxyz: Quat };
  const all = <T extends Placed>(from: readonly T[], to: readonly T[]): T[] => {
    const later = new Map(to.map((each) => [each.name, each]));
    return from.map((each) => {
      const next = later.get(each.name);
      if (!next) return each;
      const position_m = each.position_m && next.position_m ? mixed(each.position_m, next.position_m, share) : each.position_m;
      return { ...each, position_m, orientation_wxyz: turned(each.orientation_wxyz, next.orientation_wxyz, share) };
    });
  };
  const bodies = new Map(b.bodies.map((body) => [body.name, body]));
  return {
    t_s,
    sensors: all(a.sensors, b.sensors),
    bodies: a.bodies.map((body) => ({ ...body, segments: all(body.segments, bodies.get(body.name)?.segments ?? []) })),
  };
}
