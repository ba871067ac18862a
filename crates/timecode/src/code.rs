//! Numbers of frames and what they are called: SMPTE 12M, with drop-frame counting.

use std::fmt;

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A frame by its name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Plain)]
pub struct Frame {
    /// 0 to 23.
    pub hours: u8,
    /// 0 to 59.
    pub minutes: u8,
    /// 0 to 59.
    pub seconds: u8,
    /// From 0, below the frames that are counted in a second.
    pub frames: u8,
}

impl Frame {
    /// The frame of this name.
    pub const fn new(hours: u8, minutes: u8, seconds: u8, frames: u8) -> Self {
        Self { hours, minutes, seconds, frames }
    }
}

/// How frames are named.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Plain)]
pub struct Counting {
    /// Frames that are counted in a second: 24, 25, 30, and twice as many where pictures are counted.
    pub frames_per_s: u8,
    /// Drop-frame: the first two names of each minute that is no multiple of ten are left out (four where 60 are counted).
    pub drop: bool,
}

impl Counting {
    /// Names that a minute leaves out.
    const fn dropped(self) -> u32 {
        if self.drop { self.frames_per_s as u32 / 15 } else { 0 }
    }

    /// Frames of a day, after which names begin again.
    pub const fn day(self) -> u32 {
        86_400 * self.frames_per_s as u32 - 24 * 54 * self.dropped()
    }

    /// Number of the frame of that name since midnight; `None` where there is no such name.
    pub fn number(self, frame: Frame) -> Option<u32> {
        let Frame { hours, minutes, seconds, frames } = frame;
        let is_named = hours < 24 && minutes < 60 && seconds < 60 && frames < self.frames_per_s;
        let is_left_out = seconds == 0 && minutes % 10 != 0 && u32::from(frames) < self.dropped();
        let minute = u32::from(hours) * 60 + u32::from(minutes);
        let named = (minute * 60 + u32::from(seconds)) * u32::from(self.frames_per_s) + u32::from(frames);
        (is_named && !is_left_out).then(|| named - self.dropped() * (minute - minute / 10))
    }

    /// Name of a frame by its number since midnight; one beyond a day is of the next day.
    pub fn frame(self, number: u32) -> Frame {
        let number = number % self.day();
        let (rate, dropped) = (u32::from(self.frames_per_s), self.dropped());
        let minute = 60 * rate - dropped;
        // The first minute of ten leaves nothing out.
        let ten_minutes = 10 * minute + dropped;
        let (tens, within) = (number / ten_minutes, number % ten_minutes);
        let minutes_within = if within < 60 * rate { 0 } else { (within - dropped) / minute };
        let named = number + dropped * (9 * tens + minutes_within);
        let seconds = named / rate;
        Frame {
            hours: (seconds / 3600) as u8,
            minutes: (seconds / 60 % 60) as u8,
            seconds: (seconds % 60) as u8,
            frames: (named % rate) as u8,
        }
    }
}

/// A moment by its time code: the frame, and how much of it has passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Plain)]
pub struct Label {
    /// The frame.
    pub frame: Frame,
    /// Hundredths of the frame that have passed.
    pub hundredths: u8,
    /// Drop-frame counting.
    pub drop: bool,
}

impl Label {
    /// Bytes of its text.
    pub const BYTES: usize = 14;
    /// What its text looks like, as a regular expression.
    pub const PATTERN: &str = r"^\d\d:\d\d:\d\d[:;]\d\d\.\d\d$";

    /// `HH:MM:SS:FF.hh`, with `;` before the frames where counting drops names.
    pub fn text(self) -> [u8; Self::BYTES] {
        let Frame { hours, minutes, seconds, frames } = self.frame;
        let mut text = *b"00:00:00:00.00";
        for (at, number) in [(0, hours), (3, minutes), (6, seconds), (9, frames), (12, self.hundredths)] {
            text[at] = b'0' + number / 10 % 10;
            text[at + 1] = b'0' + number % 10;
        }
        if self.drop {
            text[8] = b';';
        }
        text
    }
}

impl fmt::Display for Label {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.text().iter().try_for_each(|byte| fmt::Write::write_char(f, char::from(*byte)))
    }
}

/// A rate of pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Plain)]
#[schemars(rename = "PictureRate")]
pub enum Rate {
    /// 24000/1001 a second.
    #[serde(rename = "23.976")]
    Film24PulledDown,
    /// 24 a second.
    #[serde(rename = "24")]
    Film24,
    /// 25 a second.
    #[serde(rename = "25")]
    Video25,
    /// 30000/1001 a second, every name used.
    #[serde(rename = "29.97")]
    Video30PulledDown,
    /// 30000/1001 a second, drop-frame.
    #[serde(rename = "29.97df")]
    Video30Drop,
    /// 30 a second.
    #[serde(rename = "30")]
    Video30,
    /// 48000/1001 a second.
    #[serde(rename = "47.952")]
    Film48PulledDown,
    /// 48 a second.
    #[serde(rename = "48")]
    Film48,
    /// 50 a second.
    #[serde(rename = "50")]
    Video50,
    /// 60000/1001 a second, every name used.
    #[serde(rename = "59.94")]
    Video60PulledDown,
    /// 60000/1001 a second, drop-frame.
    #[serde(rename = "59.94df")]
    Video60Drop,
    /// 60 a second.
    #[serde(rename = "60")]
    Video60,
}

impl Rate {
    /// All rates, slowest first.
    pub const ALL: [Self; 12] = [
        Self::Film24PulledDown,
        Self::Film24,
        Self::Video25,
        Self::Video30PulledDown,
        Self::Video30Drop,
        Self::Video30,
        Self::Film48PulledDown,
        Self::Film48,
        Self::Video50,
        Self::Video60PulledDown,
        Self::Video60Drop,
        Self::Video60,
    ];

    /// Its name, as stage files and messages have it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Film24PulledDown => "23.976",
            Self::Film24 => "24",
            Self::Video25 => "25",
            Self::Video30PulledDown => "29.97",
            Self::Video30Drop => "29.97df",
            Self::Video30 => "30",
            Self::Film48PulledDown => "47.952",
            Self::Film48 => "48",
            Self::Video50 => "50",
            Self::Video60PulledDown => "59.94",
            Self::Video60Drop => "59.94df",
            Self::Video60 => "60",
        }
    }

    /// How its pictures are named.
    pub const fn counting(self) -> Counting {
        let (frames_per_s, drop) = match self {
            Self::Film24PulledDown | Self::Film24 => (24, false),
            Self::Video25 => (25, false),
            Self::Video30PulledDown | Self::Video30 => (30, false),
            Self::Video30Drop => (30, true),
            Self::Film48PulledDown | Self::Film48 => (48, false),
            Self::Video50 => (50, false),
            Self::Video60PulledDown | Self::Video60 => (60, false),
            Self::Video60Drop => (60, true),
        };
        Counting { frames_per_s, drop }
    }

    /// Pictures per second.
    pub fn hz(self) -> f64 {
        let pulled_down = matches!(
            self,
            Self::Film24PulledDown
                | Self::Video30PulledDown
                | Self::Video30Drop
                | Self::Film48PulledDown
                | Self::Video60PulledDown
                | Self::Video60Drop
        );
        let frames_per_s = f64::from(self.counting().frames_per_s);
        if pulled_down { frames_per_s / 1.001 } else { frames_per_s }
    }

    /// Pictures that a frame of its time code stands for: the code itself counts 30 a second at most.
    pub const fn pictures_per_frame(self) -> u8 {
        if self.counting().frames_per_s > 30 { 2 } else { 1 }
    }

    /// The nearest rate to `hz` of those that name their frames so.
    pub fn nearest(counting: Counting, hz: f64) -> Option<Self> {
        let distance = |rate: &Self| (rate.hz() - hz).abs();
        let named = Self::ALL.into_iter().filter(|rate| rate.counting() == counting);
        named.min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }
}

impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DROP: Counting = Counting { frames_per_s: 30, drop: true };

    #[test]
    fn drop_frame_leaves_out_two_names_a_minute_but_for_each_tenth() {
        for (number, frame) in [
            (1799, Frame::new(0, 0, 59, 29)),
            (1800, Frame::new(0, 1, 0, 2)),
            (3597, Frame::new(0, 1, 59, 29)),
            (3598, Frame::new(0, 2, 0, 2)),
            (17_981, Frame::new(0, 9, 59, 29)),
            (17_982, Frame::new(0, 10, 0, 0)),
            (107_892, Frame::new(1, 0, 0, 0)),
            (DROP.day() - 1, Frame::new(23, 59, 59, 29)),
            (DROP.day(), Frame::new(0, 0, 0, 0)),
        ] {
            assert_eq!(DROP.frame(number), frame, "{number}");
            assert_eq!(DROP.number(frame), Some(number % DROP.day()), "{frame:?}");
        }
        assert_eq!(DROP.number(Frame::new(0, 1, 0, 1)), None);
        assert_eq!(DROP.number(Frame::new(0, 10, 0, 1)), Some(17_983));
        let double = Rate::Video60Drop.counting();
        assert_eq!(double.frame(3600), Frame::new(0, 1, 0, 4));
        // An hour of names is an hour on the wall, to 4 ms.
        assert!((107_892.0 / Rate::Video30Drop.hz() - 3600.0).abs() < 0.004);
    }

    #[test]
    fn every_frame_of_a_day_has_one_name() {
        for rate in Rate::ALL {
            let counting = rate.counting();
            let mut before = None;
            for number in (0..counting.day()).step_by(7) {
                let frame = counting.frame(number);
                assert_eq!(counting.number(frame), Some(number), "{rate} {frame:?}");
                let named = (frame.hours, frame.minutes, frame.seconds, frame.frames);
                assert!(before < Some(named), "{rate} {frame:?}");
                before = Some(named);
            }
        }
    }

    #[test]
    fn names_that_do_not_exist_have_no_number() {
        let counting = Rate::Video25.counting();
        for wrong in [
            Frame::new(24, 0, 0, 0),
            Frame::new(0, 60, 0, 0),
            Frame::new(0, 0, 60, 0),
            Frame::new(0, 0, 0, 25),
            Frame::new(255, 255, 255, 255),
        ] {
            assert_eq!(counting.number(wrong), None);
        }
    }

    #[test]
    fn a_label_is_written_as_editors_write_it() {
        let label = Label { frame: Frame::new(1, 2, 3, 4), hundredths: 5, drop: false };
        assert_eq!(label.to_string(), "01:02:03:04.05");
        assert_eq!(Label { drop: true, ..label }.to_string(), "01:02:03;04.05");
    }

    #[test]
    fn a_rate_is_identified_by_its_counting_and_its_pace() {
        for rate in Rate::ALL {
            for drift in [-1e-4, 0.0, 1e-4] {
                assert_eq!(Rate::nearest(rate.counting(), rate.hz() * (1.0 + drift)), Some(rate));
            }
            assert_eq!(serde_json::to_value(rate).unwrap(), rate.name());
        }
    }
}
