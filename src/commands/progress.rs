//! A progress bar over a recording that takes longer than two seconds; silent where nobody looks.

use std::path::Path;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};

/// From here on a person wonders.
const PATIENCE: Duration = Duration::from_secs(2);

/// How far a command has read a recording.
pub(crate) struct Progress {
    bar: ProgressBar,
    shown: bool,
    what: &'static str,
}

impl Progress {
    /// Over the bytes of `path`.
    pub(crate) fn over(path: &Path, what: &'static str) -> Self {
        let bytes = path.metadata().map_or(0, |file| file.len());
        Self {
            bar: ProgressBar::with_draw_target(Some(bytes), ProgressDrawTarget::hidden()),
            shown: false,
            what,
        }
    }

    /// So many bytes are done.
    pub(crate) fn at(&mut self, bytes: u64) {
        if !self.shown && self.bar.elapsed() > PATIENCE {
            self.shown = true;
            // Draws nothing unless stderr is a terminal.
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
            let left = |state: &ProgressState, text: &mut dyn std::fmt::Write| {
                // There is nobody to tell that a line could not be drawn.
                let _ = write!(text, "{:.0} s left", state.eta().as_secs_f64());
            };
            if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {percent} % {left}") {
                self.bar.set_style(style.with_key("left", left));
            }
            self.bar.set_message(self.what);
        }
        self.bar.set_position(bytes);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
