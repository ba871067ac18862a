// Draws the ruler and the lanes: only what is seen, and of what falls into one pixel one.

import { clock } from "../format";
import { type Lane, type LaneName, seen } from "./lanes";
import { type Window, lengthOf, ticks } from "./window";

/** Height of the ruler and of a lane, CSS px. */
export const RULER_PX = 20;
export const LANE_PX = 18;
const LABELS_APART_PX = 84;
/** Narrower than this a label says nothing, px. */
const LABELLED_PX = 34;

/** The colours of theme.css that it is drawn in. */
export type Colours = Record<"ink" | "quiet" | "line" | "surface" | "accent" | "bad" | "care" | "good" | "edge", string> & { kinds: string[] };

const colourOf: Record<LaneName, (colours: Colours, kind: number) => string> = {
  marks: ({ accent }) => accent,
  labels: ({ kinds }, kind) => kinds[kind % kinds.length]!,
  segments: ({ kinds }, kind) => kinds[kind % kinds.length]!,
  repetitions: ({ good, edge }, kind) => (kind === 0 ? good : edge),
  faults: ({ bad }) => bad,
  key_poses: ({ care }) => care,
};

export function draw(context: CanvasRenderingContext2D, lanes: readonly Lane[], window: Window, begun_s: number, width_px: number, colours: Colours): void {
  const px = (t_s: number) => ((t_s - window.from_s) / lengthOf(window)) * width_px;
  context.clearRect(0, 0, width_px, RULER_PX + LANE_PX * lanes.length);
  ruler(context, window, begun_s, width_px, lanes.length, colours, px);
  lanes.forEach((lane, i) => drawLane(context, lane, RULER_PX + i * LANE_PX, window, width_px, colours, px));
}

function ruler(context: CanvasRenderingContext2D, window: Window, begun_s: number, width_px: number, lanes: number, colours: Colours, px: (t_s: number) => number): void {
  const { step_s, times_s } = ticks(window, begun_s, width_px, LABELS_APART_PX);
  const digits = step_s >= 1 ? 0 : step_s >= 0.1 ? 1 : 2;
  context.font = "11px system-ui, sans-serif";
  context.textBaseline = "middle";
  context.strokeStyle = colours.line;
  context.beginPath();
  for (const t_s of times_s) {
    const x = Math.round(px(t_s)) + 0.5;
    context.moveTo(x, 0);
    context.lineTo(x, RULER_PX + lanes * LANE_PX);
  }
  context.stroke();
  context.fillStyle = colours.quiet;
  for (const t_s of times_s) {
    const since_s = t_s - begun_s;
    // The digits after the point of what the clock leaves out.
    const rest = digits > 0 ? (since_s + 1e-6 - Math.floor(since_s + 1e-6)).toFixed(digits).slice(1) : "";
    context.fillText(clock(since_s + 1e-6) + rest, px(t_s) + 4, RULER_PX / 2);
  }
}

function drawLane(context: CanvasRenderingContext2D, lane: Lane, y: number, window: Window, width_px: number, colours: Colours, px: (t_s: number) => number): void {
  const [top, height] = [y + 2, LANE_PX - 4];
  context.fillStyle = colours.line;
  context.fillRect(0, y + LANE_PX - 1, width_px, 1);
  const moments = lane.name === "marks" || lane.name === "key_poses";
  let filled_px = -Infinity;
  /** Where the words of the mark before may begin. */
  let words: { says: string; x: number } | null = null;
  const write = (until_px: number) => {
    if (words && words.says !== "") label(context, words.says, words.x, top, until_px - words.x, height, colours.ink);
    words = null;
  };
  for (const { from_s, to_s, says, kind } of seen(lane, window)) {
    const left = px(from_s);
    const right = Math.max(px(to_s), left + 2);
    // What others of this lane have covered to the pixel is not seen.
    if (Math.floor(right) <= filled_px) continue;
    context.fillStyle = colourOf[lane.name](colours, kind);
    if (lane.name === "marks") {
      write(left);
      context.fillStyle = colours.accent;
      flag(context, left, top, height);
      words = { says, x: left + 9 };
    } else if (moments) {
      diamond(context, left, top + height / 2, height / 2 - 1);
    } else {
      const from = Math.max(left, filled_px, 0);
      const until = Math.min(right, width_px);
      // Neighbours stay apart as long as there is room for it.
      context.fillRect(from, top, until - from - (until - from > 3 ? 1 : 0), height);
      label(context, says, from, top, until - from, height, colours.surface);
    }
    filled_px = Math.floor(right);
  }
  write(width_px);
}

function flag(context: CanvasRenderingContext2D, x: number, top: number, height: number): void {
  context.beginPath();
  context.moveTo(x - 0.75, top);
  context.lineTo(x + 7, top + height / 3);
  context.lineTo(x + 0.75, top + (2 * height) / 3);
  context.lineTo(x + 0.75, top + height);
  context.lineTo(x - 0.75, top + height);
  context.fill();
}

function diamond(context: CanvasRenderingContext2D, x: number, y: number, radius: number): void {
  context.beginPath();
  context.moveTo(x, y - radius);
  context.lineTo(x + radius * 0.7, y);
  context.lineTo(x, y + radius);
  context.lineTo(x - radius * 0.7, y);
  context.fill();
}

/** Words where they have room. */
function label(context: CanvasRenderingContext2D, says: string, x: number, top: number, room_px: number, height: number, colour: string): void {
  if (room_px < LABELLED_PX) return;
  context.save();
  context.beginPath();
  context.rect(x, top, room_px - 2, height);
  context.clip();
  context.fillStyle = colour;
  context.fillText(says, x + 4, top + height / 2 + 0.5);
  context.restore();
}
