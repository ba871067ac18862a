//! Reports for a therapist: of one session, and of a course of weeks, each one self-contained HTML page that prints well.
//!
//! What comes in: sessions as the store gives them. What goes out: HTML with its style and its drawings inside. What it never does:
//! load anything, run a script, or show a number that does not follow from the repetitions.

mod chart;
mod course;
mod html;
mod session;
#[cfg(test)]
mod tests;
mod words;

pub use course::course;
pub use html::STYLE;
pub use session::session;

use jiff::tz::TimeZone;
use posed_motion::exercise::Language;

/// For whom a report is.
#[derive(Clone, Debug)]
pub struct Reader {
    /// In which language.
    pub language: Language,
    /// In which time zone dates are.
    pub time_zone: TimeZone,
}

impl Reader {
    /// A word or sentence in the reader's language.
    fn say(&self, english: &'static str, german: &'static str) -> &'static str {
        match self.language {
            Language::English => english,
            Language::German => german,
        }
    }

    /// A number with so many digits, with the reader's decimal sign; a dash where it is absent.
    fn number(&self, value: Option<f64>, digits: usize) -> String {
        let Some(value) = value else { return "–".to_owned() };
        let text = format!("{value:.digits$}");
        // Zero has no sign.
        let text =
            if text.trim_start_matches(['-', '0', '.']).is_empty() { text.replace('-', "") } else { text };
        match self.language {
            Language::English => text,
            Language::German => text.replace('.', ","),
        }
    }

    /// A time of RFC 3339 as a date with the time of day.
    fn moment(&self, rfc3339: &str) -> String {
        self.date(rfc3339, "%Y-%m-%d %H:%M", "%d.%m.%Y %H:%M")
    }

    /// The same as a date.
    fn day(&self, rfc3339: &str) -> String {
        self.date(rfc3339, "%Y-%m-%d", "%d.%m.%Y")
    }

    fn date(&self, rfc3339: &str, english: &'static str, german: &'static str) -> String {
        let Ok(time) = rfc3339.parse::<jiff::Timestamp>() else { return rfc3339.to_owned() };
        time.to_zoned(self.time_zone.clone()).strftime(self.say(english, german)).to_string()
    }

    /// Minutes and seconds.
    fn minutes(&self, seconds: Option<f64>) -> String {
        let Some(seconds) = seconds else { return self.say("goes on", "läuft").to_owned() };
        let seconds = seconds.round() as u64;
        format!("{}:{:02} min", seconds / 60, seconds % 60)
    }
}
