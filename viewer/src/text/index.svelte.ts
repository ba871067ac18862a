// The words of the page, in the language that is chosen.

import { de } from "./de";
import { en, type Text } from "./en";
import { type Language, chosenLanguage, keepLanguage } from "./language";

export { LANGUAGES, type Language } from "./language";
export const TEXTS: Record<Language, Text> = { en, de };

class Words {
  #language = $state<Language>(chosenLanguage());

  get language(): Language {
    return this.#language;
  }

  set language(language: Language) {
    this.#language = language;
    keepLanguage(language);
  }

  get text(): Text {
    return TEXTS[this.#language];
  }
}

export const words = new Words();
