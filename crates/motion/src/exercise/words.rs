//! Remarks in words, for the person who moves: in English and German.
//!
//! What comes in: a remark, and the name of the channel that it speaks of. What goes out: one sentence about the body, with its size in
//! whole degrees and where it was. What it never does: name a sensor or its axis; who has no joints hears of the whole movement.

use serde::{Deserialize, Serialize};

use super::joint::{Joint, Part, Side};
use super::judge::Reason;
use super::remark::{DeviationKind, MovementPhase, Remark};

/// A language that people are spoken to in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Language {
    /// English.
    #[default]
    English,
    /// German.
    German,
}

impl Language {
    fn pick<T>(self, english: T, german: T) -> T {
        match self {
            Self::English => english,
            Self::German => german,
        }
    }
}

/// What to say of a repetition to the person who moves: the remark, in words of the channel that it speaks of, or why it does not count;
/// `None` where all was as taught, and of what is not complete.
pub fn sentence(
    remark: Option<Remark>,
    reason: Option<Reason>,
    channel: &str,
    language: Language,
) -> Option<String> {
    let remark = remark.map(|remark| remark.sentence(channel, language));
    remark.or_else(|| reason.map(|reason| reason.sentence(language).to_owned()))
}

impl Remark {
    /// One sentence for the person who moves; `channel` is the name of the channel it speaks of.
    pub fn sentence(&self, channel: &str, language: Language) -> String {
        match *self {
            Self::Deviation { deviation, kind, place, .. } => match Joint::of(channel) {
                Some(joint) => deviates(&joint, deviation, kind, place, language),
                None => language.pick("otherwise than shown", "anders als gezeigt").to_owned(),
            },
            Self::Size(size) if size < 1.0 => {
                language.pick("smaller than shown", "kleiner als gezeigt").to_owned()
            }
            Self::Size(_) => language.pick("larger than shown", "größer als gezeigt").to_owned(),
            Self::Tempo(tempo) if tempo > 1.0 => {
                let (english, german) = ("slower than shown", "langsamer als gezeigt");
                times(language.pick(english, german), tempo, language)
            }
            Self::Tempo(tempo) => {
                let (english, german) = ("faster than shown", "schneller als gezeigt");
                times(language.pick(english, german), tempo, language)
            }
            Self::Jerky => language.pick("less smooth than shown", "weniger flüssig als gezeigt").to_owned(),
        }
    }
}

impl Reason {
    /// Why a repetition did not count, for the person who moves.
    pub fn sentence(self, language: Language) -> &'static str {
        match self {
            Self::TooFast => language
                .pick("not counted: much faster than shown", "nicht gezählt: viel schneller als gezeigt"),
            Self::TooSlow => language
                .pick("not counted: much slower than shown", "nicht gezählt: viel langsamer als gezeigt"),
            Self::TooSmall => language.pick("not counted: not far enough", "nicht gezählt: nicht weit genug"),
            Self::TooLarge => language.pick("not counted: much too far", "nicht gezählt: viel zu weit"),
            Self::Different => {
                language.pick("not counted: another movement", "nicht gezählt: eine andere Bewegung")
            }
            Self::Incomplete => {
                language.pick("not counted: not finished", "nicht gezählt: nicht zu Ende geführt")
            }
            Self::TooSoon => language.pick(
                "not counted: too soon after the one before",
                "nicht gezählt: zu früh nach der letzten",
            ),
        }
    }
}

fn times(text: &str, tempo: f64, language: Language) -> String {
    let factor = format!("{tempo:.1}");
    let duration = language.pick("times the duration", "fache Dauer");
    match language {
        Language::English => format!("{text}: {factor} {duration}"),
        Language::German => format!("{text}: {}-{duration}", factor.replace('.', ",")),
    }
}

/// `right elbow bent 20 degrees less than shown at the top`.
fn deviates(
    joint: &Joint<'_>,
    deviation: f64,
    kind: DeviationKind,
    place: MovementPhase,
    language: Language,
) -> String {
    // Of a joint whose angle falls towards its turning point, a smaller way is a larger angle.
    let (positive, more) = match kind {
        DeviationKind::Short => (deviation < 0.0, false),
        DeviationKind::TooFar => (deviation > 0.0, true),
        DeviationKind::TooHigh => (true, true),
        DeviationKind::TooLow => (true, false),
        DeviationKind::Moved => return compensates(joint, deviation, language),
    };
    let size = (deviation * joint.degrees).abs().round();
    let (name, verb, place) =
        (joint_name(joint, language), verb(joint, positive, language), place.words(joint, language));
    match language {
        Language::English => {
            let more = if more { "more" } else { "less" };
            format!("{name} {verb} {size} degrees {more} than shown {place}")
        }
        Language::German => {
            let more = if more { "mehr" } else { "weniger" };
            format!("{name} {place} {size} Grad {more} {verb} als gezeigt")
        }
    }
}

/// `trunk leaned back by 20 degrees meanwhile: keep it still`.
fn compensates(joint: &Joint<'_>, deviation: f64, language: Language) -> String {
    let size = (deviation * joint.degrees).abs().round();
    let (name, verb) = (joint_name(joint, language), verb(joint, deviation > 0.0, language));
    match language {
        Language::English => format!("{name} {verb} by {size} degrees meanwhile: keep it still"),
        Language::German => format!("{name} dabei um {size} Grad {verb}: ruhig halten"),
    }
}

/// A joint with its side: `right elbow`.
pub fn joint_name(joint: &Joint<'_>, language: Language) -> String {
    match language {
        Language::English => {
            let name = match joint.joint {
                "spine" | "trunk" | "torso" => "trunk".to_owned(),
                other => other.replace('_', " "),
            };
            match joint.side {
                Some(Side::Left) => format!("left {name}"),
                Some(Side::Right) => format!("right {name}"),
                None => name,
            }
        }
        Language::German => {
            // Nouns with the endings of their adjectives.
            let (name, ending) = match joint.joint {
                "elbow" => ("Ellenbogen", "er"),
                "shoulder" => ("Schulter", "e"),
                "hip" => ("Hüfte", "e"),
                "knee" => ("Knie", "es"),
                "wrist" => ("Handgelenk", "es"),
                "ankle" => ("Sprunggelenk", "es"),
                "spine" | "trunk" | "torso" => ("Rumpf", "er"),
                "neck" | "head" => ("Kopf", "er"),
                other => (other, "es"),
            };
            match joint.side {
                Some(Side::Left) => format!("link{ending} {name}"),
                Some(Side::Right) => format!("recht{ending} {name}"),
                None => name.to_owned(),
            }
        }
    }
}

/// What a joint does whose angle is larger, or smaller.
fn verb(joint: &Joint<'_>, positive: bool, language: Language) -> &'static str {
    let trunk = matches!(joint.joint, "spine" | "trunk" | "torso" | "neck" | "head");
    let (english, german) = match (joint.joint, joint.movement, positive) {
        (_, "flexion", true) if trunk => ("leaned forward", "nach vorn geneigt"),
        (_, "flexion", false) if trunk => ("leaned back", "nach hinten geneigt"),
        (_, "lateral", true) if trunk => ("leaned to the right", "nach rechts geneigt"),
        (_, "lateral", false) if trunk => ("leaned to the left", "nach links geneigt"),
        ("shoulder", "flexion", true) => ("lifted forward", "nach vorn gehoben"),
        ("shoulder", "flexion", false) => ("moved back", "nach hinten geführt"),
        ("shoulder", "elevation", true) => ("lifted", "gehoben"),
        ("shoulder", "elevation", false) => ("lowered", "gesenkt"),
        (_, "abduction", true) | (_, "adduction", false) => ("moved to the side", "zur Seite geführt"),
        (_, "abduction", false) | (_, "adduction", true) => ("moved inwards", "nach innen geführt"),
        (_, "pronation", true) => ("turned palm down", "mit der Handfläche nach unten gedreht"),
        (_, "pronation", false) => ("turned palm up", "mit der Handfläche nach oben gedreht"),
        (_, "plane", true) => ("brought forward", "nach vorn geführt"),
        (_, "plane", false) => ("brought outwards", "nach außen geführt"),
        (_, "rotation", true) => ("turned inwards", "einwärts gedreht"),
        (_, "rotation", false) => ("turned outwards", "auswärts gedreht"),
        (_, _, true) => ("bent", "gebeugt"),
        (_, _, false) => ("straightened", "gestreckt"),
    };
    language.pick(english, german)
}

impl MovementPhase {
    /// Where a joint is. Arms turn at the top; knees, hips and the trunk do where the body is low.
    fn words(self, joint: &Joint<'_>, language: Language) -> &'static str {
        let (way_up, top) = match joint.part() {
            Some(Part::Arm) => ("on the way up", "at the top"),
            _ => ("on the way there", "at the turning point"),
        };
        match self {
            Self::Start => language.pick("at the start", "am Anfang"),
            Self::WayUp => language.pick(way_up, "auf dem Hinweg"),
            Self::Top => language.pick(top, "am Umkehrpunkt"),
            Self::WayBack => language.pick("on the way back", "auf dem Rückweg"),
            Self::End => language.pick("at the end", "am Ende"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_remark_speaks_of_the_body_in_both_languages() {
        let said = |channel: &str, deviation, kind, place| {
            let remark = Remark::Deviation { channel: 0, deviation, kind, place };
            [Language::English, Language::German].map(|language| remark.sentence(channel, language))
        };
        assert_eq!(
            said("elbow_r_flexion_deg", -20.4, DeviationKind::Short, MovementPhase::Top),
            [
                "right elbow bent 20 degrees less than shown at the top",
                "rechter Ellenbogen am Umkehrpunkt 20 Grad weniger gebeugt als gezeigt"
            ]
        );
        // It falls towards its turning point, and did not fall as far.
        assert_eq!(
            said("shoulder_l_flexion_deg", 15.0, DeviationKind::Short, MovementPhase::Top)[0],
            "left shoulder moved back 15 degrees less than shown at the top"
        );
        assert_eq!(
            said("knee_rad", 0.5, DeviationKind::TooHigh, MovementPhase::WayBack),
            [
                "knee bent 29 degrees more than shown on the way back",
                "Knie auf dem Rückweg 29 Grad mehr gebeugt als gezeigt"
            ]
        );
        assert_eq!(
            said("spine_flexion_deg", -20.0, DeviationKind::Moved, MovementPhase::Top),
            [
                "trunk leaned back by 20 degrees meanwhile: keep it still",
                "Rumpf dabei um 20 Grad nach hinten geneigt: ruhig halten"
            ]
        );
        // Who squats is low where the knee turns.
        for (place, expected) in [
            (MovementPhase::Top, "knee bent 20 degrees less than shown at the turning point"),
            (MovementPhase::WayUp, "knee bent 20 degrees less than shown on the way there"),
        ] {
            assert_eq!(said("knee_flexion_deg", -20.0, DeviationKind::Short, place)[0], expected);
        }
        // A sensor's axis is never named.
        let watch = said("watch_gx", 3.0, DeviationKind::TooHigh, MovementPhase::Top);
        assert_eq!(watch, ["otherwise than shown", "anders als gezeigt"]);
        assert_eq!(
            Remark::Tempo(1.62).sentence("", Language::German),
            "langsamer als gezeigt: 1,6-fache Dauer"
        );
    }
}
