// What a person hears of a repetition, in the language that is wished.

import type { Repetition } from "./model";

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

/** Speaks; what was not said yet is over. */
export function say(text: string, language: Language): void {
  const utterance = new SpeechSynthesisUtterance(text);
  utterance.lang = language;
  speechSynthesis.cancel();
  speechSynthesis.speak(utterance);
}
