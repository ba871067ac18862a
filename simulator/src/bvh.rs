//! BioVision hierarchy files: skeleton, channels, frames; forward kinematics.
//!
//! What comes in: the text of a `.bvh` file. What goes out: the pose of every joint in every frame, in
//! the file's own axes and unit of length.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// What is wrong with the text of a BVH file, and where.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: expected {expected}, found {found}")]
pub struct BvhError {
    /// Line, from 1.
    pub line: usize,
    /// Column, from 1, in characters.
    pub column: usize,
    /// What should stand there.
    pub expected: String,
    /// What stands there.
    pub found: String,
}

/// One degree of freedom of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channel {
    /// Along axis 0, 1, 2, in the file's unit.
    Position(usize),
    /// About axis 0, 1, 2, degrees.
    Rotation(usize),
}

#[derive(Clone, Debug, PartialEq)]
struct Joint {
    name: String,
    parent: Option<usize>,
    offset: Vector3<f64>,
    channels: Vec<Channel>,
}

/// A parsed file: a hierarchy of joints and the values of their channels in every frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Bvh {
    joints: Vec<Joint>,
    /// Where the chains end: the joint that an end site hangs on, and its place in that joint's axes.
    ends: Vec<(usize, Vector3<f64>)>,
    /// Time between frames, s, above 0.
    pub frame_time_s: f64,
    /// All channel values, frame after frame.
    values: Vec<f64>,
    channels: usize,
}

impl Bvh {
    /// Parses the text of a file.
    ///
    /// # Errors
    /// Names line and column of the first word that does not belong, or of the end of the file.
    pub fn parse(text: &str) -> Result<Self, BvhError> {
        let mut words = Words::new(text);
        let (joints, ends) = hierarchy(&mut words)?;
        let channels: usize = joints.iter().map(|joint| joint.channels.len()).sum();
        words.expect("Frames:")?;
        let frames = words.count("the number of frames")?;
        words.expect("Frame")?;
        words.expect("Time:")?;
        let frame_time_s = words.number("the time between frames in seconds")?;
        if frame_time_s <= 0.0 {
            return Err(words.wrong("a time between frames above 0"));
        }
        let mut values = Vec::new();
        for frame in 0..frames {
            for channel in 0..channels {
                let expected = || format!("value {} of {channels} in frame {frame} of {frames}", channel + 1);
                values.push(words.number_or(expected)?);
            }
        }
        if frames == 0 || channels == 0 {
            return Err(words.wrong("at least one frame with one channel"));
        }
        words.end()?;
        Ok(Self { joints, ends, frame_time_s, values, channels })
    }

    /// Names of the joints, root first; end sites are not joints.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.joints.iter().map(|joint| joint.name.as_str())
    }

    /// Where the chains end: index of the joint that an end site hangs on, and its place in that joint's axes, in the file's unit.
    pub fn ends(&self) -> &[(usize, Vector3<f64>)] {
        &self.ends
    }

    /// How many frames there are, at least one.
    pub fn frames(&self) -> usize {
        self.values.len() / self.channels
    }

    /// Poses of all joints in a frame, in the order of [`Bvh::names`]: joint to file axes, lengths in the file's unit.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn poses(&self, frame: usize) -> Vec<Isometry3<f64>> {
        self.placed(&self.values[frame * self.channels..][..self.channels])
    }

    /// Poses of all joints at rest, where all channels are zero.
    pub fn rest(&self) -> Vec<Isometry3<f64>> {
        self.placed(&vec![0.0; self.channels])
    }

    /// Whether no joint is turned in a frame.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn rests(&self, frame: usize) -> bool {
        let values = &self.values[frame * self.channels..][..self.channels];
        let channels = self.joints.iter().flat_map(|joint| &joint.channels);
        channels.zip(values).all(|(channel, value)| matches!(channel, Channel::Position(_)) || *value == 0.0)
    }

    fn placed(&self, values: &[f64]) -> Vec<Isometry3<f64>> {
        let mut values = values.iter();
        let mut poses: Vec<Isometry3<f64>> = Vec::with_capacity(self.joints.len());
        for joint in &self.joints {
            let mut shift = joint.offset;
            let mut rotation = UnitQuaternion::identity();
            for (channel, &value) in joint.channels.iter().zip(values.by_ref()) {
                match *channel {
                    // A root's position channels replace its offset in practice, a joint's add to it; files
                    // with root offsets other than zero repeat them in the channels.
                    Channel::Position(axis) if joint.parent.is_none() => shift[axis] = value,
                    Channel::Position(axis) => shift[axis] += value,
                    Channel::Rotation(axis) => {
                        let mut rotation_vector_rad = Vector3::zeros();
                        rotation_vector_rad[axis] = value.to_radians();
                        rotation *= UnitQuaternion::from_scaled_axis(rotation_vector_rad);
                    }
                }
            }
            let local = Isometry3::from_parts(Translation3::from(shift), rotation);
            poses.push(joint.parent.map_or(local, |parent| poses[parent] * local));
        }
        poses
    }
}

/// Joints, and by the joint that they end where the ends of the bones are.
type Hierarchy = (Vec<Joint>, Vec<(usize, Vector3<f64>)>);

/// Everything from `HIERARCHY` to `MOTION`.
fn hierarchy(words: &mut Words<'_>) -> Result<Hierarchy, BvhError> {
    let mut joints: Vec<Joint> = Vec::new();
    let mut ends = Vec::new();
    let mut open: Vec<usize> = Vec::new();
    words.expect("HIERARCHY")?;
    loop {
        let word = words.next("ROOT, JOINT, End, } or MOTION")?;
        match word {
            "ROOT" if open.is_empty() => open.push(joint(words, &mut joints, None)?),
            "JOINT" if !open.is_empty() => {
                let parent = open.last().copied();
                open.push(joint(words, &mut joints, parent)?);
            }
            "End" if !open.is_empty() => {
                for word in ["Site", "{", "OFFSET"] {
                    words.expect(word)?;
                }
                ends.extend(open.last().copied().zip(Some(offset(words)?)));
                words.expect("}")?;
            }
            "}" if open.pop().is_some() => {}
            "MOTION" if open.is_empty() && !joints.is_empty() => return Ok((joints, ends)),
            _ if open.is_empty() => return Err(words.wrong("ROOT or MOTION")),
            _ => return Err(words.wrong("JOINT, End or }")),
        }
    }
}

/// Name, brace, offset and channels of a joint; returns its index.
fn joint(words: &mut Words<'_>, joints: &mut Vec<Joint>, parent: Option<usize>) -> Result<usize, BvhError> {
    let name = words.next("the name of a joint")?.to_owned();
    if joints.iter().any(|joint| joint.name == name) {
        return Err(words.wrong("a name that no other joint has"));
    }
    words.expect("{")?;
    words.expect("OFFSET")?;
    let offset = offset(words)?;
    words.expect("CHANNELS")?;
    let mut channels = Vec::new();
    for _ in 0..words.count("the number of channels")? {
        channels.push(match words.next("the name of a channel")? {
            "Xposition" => Channel::Position(0),
            "Yposition" => Channel::Position(1),
            "Zposition" => Channel::Position(2),
            "Xrotation" => Channel::Rotation(0),
            "Yrotation" => Channel::Rotation(1),
            "Zrotation" => Channel::Rotation(2),
            _ => {
                return Err(words.wrong("Xposition, Yposition, Zposition, Xrotation, Yrotation or Zrotation"));
            }
        });
    }
    joints.push(Joint { name, parent, offset, channels });
    Ok(joints.len() - 1)
}

fn offset(words: &mut Words<'_>) -> Result<Vector3<f64>, BvhError> {
    let mut offset = Vector3::zeros();
    for coordinate in offset.iter_mut() {
        *coordinate = words.number("a coordinate of the offset")?;
    }
    Ok(offset)
}

/// The words of a text, with their places.
struct Words<'a> {
    text: &'a str,
    /// Byte offset behind the last word.
    position: usize,
    /// Byte offset of the last word.
    start: usize,
}

impl<'a> Words<'a> {
    fn new(text: &'a str) -> Self {
        Self { text, position: 0, start: 0 }
    }

    /// The next word; empty at the end of the text.
    fn advance(&mut self) -> &'a str {
        let rest = &self.text[self.position..];
        let trimmed = rest.trim_start();
        self.start = self.position + rest.len() - trimmed.len();
        let length = trimmed.find(char::is_whitespace).unwrap_or(trimmed.len());
        self.position = self.start + length;
        &trimmed[..length]
    }

    fn next(&mut self, expected: &str) -> Result<&'a str, BvhError> {
        let word = self.advance();
        if word.is_empty() { Err(self.wrong(expected)) } else { Ok(word) }
    }

    fn expect(&mut self, expected: &str) -> Result<(), BvhError> {
        if self.advance() == expected { Ok(()) } else { Err(self.wrong(expected)) }
    }

    fn number(&mut self, expected: &str) -> Result<f64, BvhError> {
        self.number_or(|| expected.to_owned())
    }

    fn number_or(&mut self, expected: impl Fn() -> String) -> Result<f64, BvhError> {
        let number = self.advance().parse::<f64>().ok().filter(|x| x.is_finite());
        number.ok_or_else(|| self.wrong(&expected()))
    }

    fn count(&mut self, expected: &str) -> Result<usize, BvhError> {
        self.advance().parse().map_err(|_| self.wrong(expected))
    }

    fn end(&mut self) -> Result<(), BvhError> {
        if self.advance().is_empty() { Ok(()) } else { Err(self.wrong("the end of the file")) }
    }

    /// The error that the last word is not what was expected.
    fn wrong(&self, expected: &str) -> BvhError {
        let before = &self.text[..self.start];
        let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
        let word: String = self.text[self.start..self.position].chars().take(40).collect();
        BvhError {
            line: before.matches('\n').count() + 1,
            column: self.text[line_start..self.start].chars().count() + 1,
            expected: expected.to_owned(),
            found: if word.is_empty() { "the end of the file".to_owned() } else { format!("`{word}`") },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) const ARM: &str = "HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Arm
  {
    OFFSET 10 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 5 0 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.01
0 100 0 0 0 0 0 0 0
1 100 0 90 0 0 0 90 0
";

    #[test]
    fn joints_follow_their_parents() {
        let bvh = Bvh::parse(ARM).unwrap();
        assert_eq!(bvh.names().collect::<Vec<_>>(), ["Hips", "Arm"]);
        assert_eq!((bvh.frames(), bvh.frame_time_s), (2, 0.01));
        let rest = bvh.poses(0);
        assert_eq!(rest[1].translation.vector, Vector3::new(10.0, 100.0, 0.0));
        let turned = bvh.poses(1);
        // A quarter turn about z carries the arm from x to y; the arm then turns about its own x.
        assert!((turned[1].translation.vector - Vector3::new(1.0, 110.0, 0.0)).norm() < 1e-9);
        assert!((turned[1].rotation * Vector3::y() - Vector3::z()).norm() < 1e-9);
        assert!((turned[1].rotation * Vector3::x() - Vector3::y()).norm() < 1e-9);
    }

    #[test]
    fn errors_name_line_and_column() {
        let broken = |from: &str, to: &str| Bvh::parse(&ARM.replacen(from, to, 1)).unwrap_err().to_string();
        assert_eq!(
            broken("OFFSET 10 0 0", "OFFSET 10 zero 0"),
            "line 8, column 15: expected a coordinate of the offset, found `zero`"
        );
        assert_eq!(
            broken("CHANNELS 3 Z", "CHANNELS 3 W"),
            "line 9, column 16: expected Xposition, Yposition, Zposition, Xrotation, Yrotation or Zrotation, \
             found `Wrotation`"
        );
        assert_eq!(
            broken("90 0 0 0 90 0\n", "90 0 0 0 90\n"),
            "line 21, column 1: expected value 9 of 9 in frame 1 of 2, found the end of the file"
        );
        assert_eq!(
            broken("90 0 0 0 90 0\n", "90 0 0 0 90 0 7\n"),
            "line 20, column 23: expected the end of the file, found `7`"
        );
        assert_eq!(
            broken("JOINT Arm", "JOINT Hips"),
            "line 6, column 9: expected a name that no other joint has, found `Hips`"
        );
        assert!(broken("Frame Time: 0.01", "Frame Time: 0").contains("line 18"));
        assert!(Bvh::parse("").unwrap_err().to_string().contains("expected HIERARCHY"));
        assert!(Bvh::parse("HIERARCHY\nMOTION").is_err(), "no joint");
    }

    proptest::proptest! {
        #[test]
        fn no_text_makes_it_panic(cut in 0usize..400, word in "[A-Za-z0-9{}. \n]{0,20}") {
            let mut text = ARM.to_owned();
            let cut = cut.min(text.len());
            text.insert_str(cut, &word);
            if let Ok(bvh) = Bvh::parse(&text) {
                for frame in 0..bvh.frames() {
                    bvh.poses(frame);
                }
            }
        }
    }
}
