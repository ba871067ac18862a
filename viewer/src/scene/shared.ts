// The one picture of the stage: Watch and the wall show the same, and a browser has few contexts to draw with.

import { model } from "../page.svelte";
import { words } from "../text/index.svelte";
import { StageScene } from "./stage";

let made: StageScene | null | undefined;

/** Null where the browser has no WebGL. */
export function stageScene(): StageScene | null {
  if (made !== undefined) return made;
  try {
    made = new StageScene(model, words.text.watch.picture);
  } catch {
    made = null;
  }
  return made;
}
