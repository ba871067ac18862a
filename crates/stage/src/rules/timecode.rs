//! Where time code may come from.

use super::super::problem::Notes;
use super::Item;

pub(super) fn check(timecode: &Item<'_, '_>, notes: &mut Notes<'_>) {
    let is_midi = timecode.text("signal").is_some_and(|signal| signal.value == "mtc");
    if let (Some(command), true) = (timecode.get("command"), timecode.has("path")) {
        let message = "samples come from a program or from a path, not from both";
        notes.problem(&command.span(), "command", message, "remove `command` or `path`");
    }
    if is_midi && !timecode.has("path") {
        let message = "nothing says which MIDI port the code comes from";
        let fix = "write path = \"/dev/snd/midiC1D0\" with the port's device: `ls /dev/snd/midi*` names them";
        notes.problem(&timecode.header, "path", message, fix);
    }
    if let Some(command) = timecode.get("command")
        && command.get_ref().as_array().is_some_and(|words| words.is_empty())
    {
        let fix = "write the program and its arguments, such as [\"arecord\", \"-t\", \"raw\"]";
        notes.problem(&command.span(), "command", "it names no program", fix);
    }
    if let Some(channel) = timecode.number("channel")
        && channel.value > timecode.number("channels").map_or(1.0, |channels| channels.value)
    {
        let message = "there is no such channel";
        notes.problem(&channel.at, "channel", message, "write channels = N with how many the input has");
    }
}
