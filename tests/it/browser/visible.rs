//! What somebody does who has read nothing: by the words that stand on the page, and no others.

use crate::chromium::Browser;

/// The button or link that somebody sees or hears called like this, if it can be pressed.
pub(super) fn button(called: &str) -> String {
    format!(
        "[...document.querySelectorAll('button, a')].find((each) => each.offsetHeight > 0 && !each.disabled && \
         [each.getAttribute('aria-label'), each.textContent.trim()].includes('{called}'))"
    )
}

/// Presses it as soon as it is there.
pub(super) async fn press(browser: &mut Browser, called: &str) {
    let button = button(called);
    browser.until(&format!("{button} !== undefined")).await;
    browser.value(&format!("{button}.click()")).await;
}

/// Waits for words on the page.
pub(super) async fn says(browser: &mut Browser, words: &str) {
    browser.until(&format!("document.body.innerText.includes('{words}')")).await;
}
