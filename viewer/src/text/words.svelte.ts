// The words of a page in the language that is chosen, whichever words these are.

import { type Language, chosenLanguage, keepLanguage } from "./language";

export class Words<Text> {
  #language = $state<Language>(chosenLanguage());

  constructor(private readonly texts: Record<Language, Text>) {}

  get language(): Language {
    return this.#language;
  }

  set language(language: Language) {
    this.#language = language;
    keepLanguage(language);
  }

  get text(): Text {
    return this.texts[this.#language];
  }
}
