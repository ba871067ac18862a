// In which language the page speaks: the browser's, until somebody chooses another one.

import { de } from "./de";
import { en, type Text } from "./en";

export type Language = "en" | "de";
export const LANGUAGES: Record<Language, string> = { en: "English", de: "Deutsch" };
export const TEXTS: Record<Language, Text> = { en, de };
const KEY = "posed.language";

function first(): Language {
  const kept = localStorage.getItem(KEY);
  if (kept === "en" || kept === "de") return kept;
  return navigator.language.startsWith("de") ? "de" : "en";
}

class Words {
  #language = $state<Language>(first());

  get language(): Language {
    return this.#language;
  }

  set language(language: Language) {
    this.#language = language;
    localStorage.setItem(KEY, language);
  }

  get text(): Text {
    return TEXTS[this.#language];
  }
}

export const words = new Words();
