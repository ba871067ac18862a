// The words of the page on a phone, in the language that is chosen.

import { de } from "../text/phone.de";
import { en, type PhoneText } from "../text/phone.en";
import { Words } from "../text/words.svelte";

export const words = new Words<PhoneText>({ en, de });
