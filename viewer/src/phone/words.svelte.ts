// The words of the page on a phone, in the language that is chosen.

import { type Language, chosenLanguage, keepLanguage } from "../text/language";
import { de } from "../text/phone.de";
import { en, type PhoneText } from "../text/phone.en";

class Words {
  #language = $state<Language>(chosenLanguage());

  get language(): Language {
    return this.#language;
  }

  set language(language: Language) {
    this.#language = language;
    keepLanguage(language);
  }

  get text(): PhoneText {
    return this.#language === "de" ? de : en;
  }
}

export const words = new Words();
