// What a person hears of a repetition, in the language that is wished.

import type { Repetition } from "./model";
import type { ExerciseState } from "./protocol";
import { type Language, TEXTS } from "./text/index.svelte";

/** What the daemon says in that language; null where it says nothing. */
export function spokenIn(language: Language, { sentence, sentence_de }: { sentence: string | null; sentence_de: string | null }): string | null {
  return language === "de" ? sentence_de : sentence;
}

/** One sentence of a repetition: praise where the daemon has none of one that counts; null of a movement that was not meant. */
export function sentenceOf(repetition: Repetition, language: Language): { text: string; good: boolean } | null {
  const said = spokenIn(language, repetition);
  if (said === null && repetition.event === "rejected") return null;
  // The daemon's begin small.
  const text = said === null ? TEXTS[language].coach.praise : `${said.charAt(0).toUpperCase()}${said.slice(1)}.`;
  return { text, good: said === null };
}

/** What was said of the sets, with a judged repetition in it; a count that begins anew is the next set. */
export function advance(state: ExerciseState | null, { event, exercise, count, set_count }: Repetition): ExerciseState | null {
  if (state === null) return null;
  const exercises = state.exercises.map((progress) => {
    if (progress.exercise !== exercise) return progress;
    const next = { ...progress, count, set_count };
    if (event !== "counted") return next;
    const begins = progress.set_count > 0 && set_count <= progress.set_count;
    return { ...next, set: progress.set + Number(begins), rest_until_s: null };
  });
  return { ...state, exercises };
}

/** Speaks; what was not said yet is over. */
export function say(text: string, language: Language): void {
  const utterance = new SpeechSynthesisUtterance(text);
  utterance.lang = language;
  speechSynthesis.cancel();
  speechSynthesis.speak(utterance);
}
