// What a person hears of a repetition, in the language that is wished.

import type { Repetition } from "./model";
import type { ExerciseState } from "./protocol";

export type Language = "en" | "de";

/** What is said of a repetition as taught. */
const PRAISE: Record<Language, string> = { en: "Well done.", de: "Gut gemacht." };

/** The language of this browser. */
export function ownLanguage(): Language {
  return navigator.language.startsWith("de") ? "de" : "en";
}

/** What the daemon says in that language; null where it says nothing. */
export function spokenIn(language: Language, { sentence, sentence_de }: { sentence: string | null; sentence_de: string | null }): string | null {
  return language === "de" ? sentence_de : sentence;
}

/** One sentence of a repetition: praise where the daemon has none of one that counts; null of a movement that was not meant. */
export function sentenceOf(repetition: Repetition, language: Language): { text: string; good: boolean } | null {
  const said = spokenIn(language, repetition);
  if (said === null && repetition.event === "rejected") return null;
  // The daemon's begin small.
  const text = said === null ? PRAISE[language] : `${said.charAt(0).toUpperCase()}${said.slice(1)}.`;
  return { text, good: said === null };
}

/** Takes a judged repetition into what was said of the sets; a count that begins anew is the next set. */
export function advance(state: ExerciseState | null, { event, exercise, count, set_count }: Repetition): void {
  const progress = state?.exercises.find((each) => each.exercise === exercise);
  if (!progress) return;
  if (event === "counted") {
    if (progress.set_count > 0 && set_count <= progress.set_count) progress.set++;
    progress.rest_until_s = null;
  }
  Object.assign(progress, { count, set_count });
}

/** Speaks; what was not said yet is over. */
export function say(text: string, language: Language): void {
  const utterance = new SpeechSynthesisUtterance(text);
  utterance.lang = language;
  speechSynthesis.cancel();
  speechSynthesis.speak(utterance);
}
