//! Joints by name: which of them are left and right of each other.
//!
//! What comes in: names of joints or sensors. What goes out: pairs of indices. What it never does: insist; names that
//! tell nothing make no pairs, and the input is then not turned to where the body faces.

/// The words for left and right, as they stand in names.
const SIDES: [(&str, &str); 4] = [("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"), ("l", "r")];

/// Indices of the joints that are each other's mirror image, left one first.
pub(super) fn pairs<S: AsRef<str>>(names: &[S]) -> Vec<[usize; 2]> {
    let find = |name: &str| names.iter().position(|known| known.as_ref() == name);
    let mut pairs = Vec::new();
    for (left, name) in names.iter().enumerate() {
        let right = opposites(name.as_ref()).find_map(|other| find(&other));
        if let Some(right) = right {
            pairs.push([left, right]);
        }
    }
    pairs
}

/// Name of the same thing on the other side; `None` for what has no side. Also good for the labels of movements.
pub(super) fn mirrored<S: AsRef<str>>(name: &str, names: &[S]) -> Option<usize> {
    let find = |other: String| names.iter().position(|known| known.as_ref() == other);
    opposites(name).chain(opposites_of_right(name)).find_map(find)
}

fn opposites(name: &str) -> impl Iterator<Item = String> + '_ {
    SIDES.into_iter().flat_map(move |(left, right)| exchanged(name, left, right))
}

fn opposites_of_right(name: &str) -> impl Iterator<Item = String> + '_ {
    SIDES.into_iter().flat_map(move |(left, right)| exchanged(name, right, left))
}

/// `name` with `from` at its beginning or end replaced; single letters need a border (`_l`, `.L`, `lHand`) or are at
/// the beginning, where the existence of the other name decides.
fn exchanged(name: &str, from: &str, to: &str) -> Vec<String> {
    let mut names = Vec::new();
    if let Some(rest) = name.strip_prefix(from) {
        names.push(format!("{to}{rest}"));
    }
    if from.len() > 1 {
        if let Some(at) = name.find(from) {
            names.push(format!("{}{to}{}", &name[..at], &name[at + from.len()..]));
        }
    } else {
        for (from, to) in [(from.to_owned(), to.to_owned()), (from.to_uppercase(), to.to_uppercase())] {
            for border in ["_", ".", "-", " "] {
                if let Some(rest) = name.strip_suffix(&format!("{border}{from}")) {
                    names.push(format!("{rest}{border}{to}"));
                }
            }
            if let Some(rest) = name.strip_prefix(from.as_str()) {
                names.push(format!("{to}{rest}"));
            }
        }
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_found_in_the_usual_spellings() {
        let names = ["root", "lfemur", "rfemur", "LeftHand", "RightHand", "forearm_l", "forearm_r", "L_Foot"];
        assert_eq!(pairs(&names), [[1, 2], [3, 4], [5, 6]]);
        assert!(pairs(&["lamp", "left"]).is_empty());
        let labels = ["reach left", "reach right", "walk"];
        let mirror: Vec<_> = labels.iter().map(|label| mirrored(label, &labels)).collect();
        assert_eq!(mirror, [Some(1), Some(0), None]);
    }
}
