// The words of the page, in the language that is chosen.

import { de } from "./de";
import { en, type Text } from "./en";
import type { Language } from "./language";
import { Words } from "./words.svelte";

export { LANGUAGES, type Language } from "./language";
export const TEXTS: Record<Language, Text> = { en, de };

export const words = new Words(TEXTS);
