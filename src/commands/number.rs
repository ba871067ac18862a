//! Numbers of the command line that have bounds.

use std::ops::RangeBounds;

/// A number in `range`; otherwise `bounds` says what is expected.
pub(super) fn within(
    range: impl RangeBounds<f64> + Clone,
    bounds: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| {
        let number = number(text)?;
        if range.contains(&number) { Ok(number) } else { Err(bounds.to_owned()) }
    }
}

/// A finite number above 0.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    let number = number(text)?;
    if number.is_finite() && number > 0.0 { Ok(number) } else { Err(format!("{number} is not above 0")) }
}

fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| format!("`{text}` is not a number"))
}
