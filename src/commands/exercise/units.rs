//! Units of columns whose names lack them: `--units deg`, `--units elbow=deg,lift=m`.

use std::fmt;
use std::str::FromStr;

use posed_motion::exercise::has_unit;

/// Units that an exercise knows by the end of a name.
const KNOWN: [&str; 3] = ["deg", "rad", "m"];

/// One unit, of a column or of all that have none.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Unit {
    column: Option<String>,
    unit: &'static str,
}

impl Unit {
    /// Those of `units` that concern some of the columns.
    pub(super) fn of(units: &[Self], columns: &[String]) -> Vec<Self> {
        let concerns = |unit: &&Self| unit.column.as_ref().is_none_or(|column| columns.contains(column));
        units.iter().filter(concerns).cloned().collect()
    }
}

impl FromStr for Unit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (column, unit) = match text.split_once('=') {
            Some((column, unit)) => (Some(column.to_owned()), unit),
            None => (None, text),
        };
        let unit = KNOWN.into_iter().find(|known| *known == unit);
        let unit = unit.ok_or_else(|| format!("give one of {}", KNOWN.join(", ")))?;
        Ok(Self { column, unit })
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.column {
            Some(column) => write!(f, "{column}={}", self.unit),
            None => f.write_str(self.unit),
        }
    }
}

/// Columns by the names that an exercise knows them by: with their units.
///
/// # Errors
/// A column is named that is not there, in a sentence.
pub(super) fn named(columns: &[String], units: &[Unit]) -> Result<Vec<String>, String> {
    let is_there = |name: &String| columns.contains(name);
    if let Some(name) = units.iter().filter_map(|unit| unit.column.as_ref()).find(|name| !is_there(name)) {
        return Err(format!("there is no column `{name}`"));
    }
    let name = |column: &String| {
        let own = units.iter().find(|unit| unit.column.as_ref() == Some(column));
        let of_all = || units.iter().find(|unit| unit.column.is_none() && column != "t" && !has_unit(column));
        match own.or_else(of_all) {
            Some(Unit { unit, .. }) => format!("{column}_{unit}"),
            None => column.clone(),
        }
    };
    Ok(columns.iter().map(name).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_added_to_what_has_none() {
        let columns = ["t", "elbow", "knee_deg", "gx", "wrist_qw", "lift"].map(str::to_owned);
        let parse = |text: &str| text.split(',').map(str::parse).collect::<Result<Vec<Unit>, _>>();
        let names = named(&columns, &parse("deg,lift=m").unwrap()).unwrap();
        assert_eq!(names, ["t", "elbow_deg", "knee_deg", "gx", "wrist_qw", "lift_m"]);
        assert_eq!(named(&columns, &[]).unwrap(), columns);
        assert!(named(&columns, &parse("hip=deg").unwrap()).unwrap_err().contains("`hip`"));
        assert!(parse("elbow=inch").unwrap_err().contains("deg, rad, m"));
    }
}
