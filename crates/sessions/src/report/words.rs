//! Names of joints and ways to end, for a reader.

use posed_motion::exercise::{Joint, joint_name};

use super::Reader;
use crate::session::EndedBy;

impl Reader {
    /// `right elbow, flexion`, from the name of a channel.
    pub(super) fn joint(&self, channel: &str) -> String {
        let Some(joint) = Joint::of(channel) else { return channel.to_owned() };
        let name = joint_name(&joint, self.language);
        match self.movement(joint.movement) {
            "" => name,
            movement => format!("{name}, {movement}"),
        }
    }

    fn movement<'a>(&self, movement: &'a str) -> &'a str {
        match movement {
            "flexion" => self.say("flexion", "Beugung"),
            "elevation" => self.say("elevation", "Hebung"),
            "abduction" => self.say("abduction", "Abspreizung"),
            "adduction" => self.say("adduction", "Anspreizung"),
            "rotation" => self.say("rotation", "Drehung"),
            "pronation" => self.say("pronation", "Unterarmdrehung"),
            "lateral" => self.say("lateral flexion", "Seitneigung"),
            "plane" => self.say("plane", "Ebene"),
            other => other,
        }
    }

    /// How a session ended, in words; empty where nothing needs to be said.
    pub(super) fn ended_by(&self, ended_by: Option<EndedBy>) -> &'static str {
        match ended_by {
            None => self.say("The session goes on.", "Die Sitzung läuft noch."),
            Some(EndedBy::Request) => "",
            Some(EndedBy::Plan) => self.say("The plan was completed.", "Der Plan wurde ganz durchlaufen."),
            Some(EndedBy::Daemon) => {
                self.say("The program was ended meanwhile.", "Das Programm wurde währenddessen beendet.")
            }
            Some(EndedBy::Interruption) => self.say(
                "The session broke off with the program; all until then is here.",
                "Die Sitzung brach mit dem Programm ab; alles bis dahin ist hier.",
            ),
            Some(EndedBy::Recording) => {
                self.say("Counted from a recording.", "Aus einer Aufzeichnung gezählt.")
            }
        }
    }
}
