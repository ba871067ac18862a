//! C3D: markers, joint angles and the rotations of segments, for motion laboratories. Little-endian, floats, mm, z up, in blocks of 512 bytes: header,
//! parameters, points, rotations (the extension that Qualisys, Theia and Visual3D share). Angles are points, as Vicon has them: x, y and z are a joint's
//! angles in the order of the table, degrees, and `POINT:ANGLES` has their labels.

use nalgebra::UnitQuaternion;

use super::Frame;
use super::markers::{MARKERS, points};
use posed_fusion::body::{
    ANGLE_NAMES, BodySegment, Skeleton, WHOLE, WholeSegment, joint_angles, of_joint, whole,
};

const BLOCK: usize = 512;
/// First block of the parameters, from 1.
const PARAMETERS: usize = 2;
const MM: f64 = 1000.0;
/// Frames that a word can count.
const COUNTED: usize = 65_535;

/// Kinds of a parameter's data.
const TEXT: i8 = -1;
const WORDS: i8 = 2;
const FLOATS: i8 = 4;

pub(super) fn bytes(skeleton: &Skeleton, rate_hz: f64, frames: &[Frame]) -> Vec<u8> {
    let joints = joints(frames);
    let mut data = Vec::new();
    for frame in frames {
        for point in points(skeleton, frame) {
            // The last word is the residual; below zero the point would be missing.
            put(&mut data, &[point.x * MM, point.y * MM, point.z * MM, 0.0]);
        }
        for (parent, segment) in &joints {
            let q = frame.orientations[parent.index()].inverse() * frame.orientations[segment.index()];
            let [x, y, z, ..] = joint_angles(*segment, &q).map(f64::to_degrees);
            put(&mut data, &[x, y, z, 0.0]);
        }
    }
    fill(&mut data);
    let data_blocks = data.len() / BLOCK;
    for frame in frames {
        let orientations = whole(&frame.orientations);
        let origins = skeleton.whole_origins_m(&orientations, frame.pelvis_m);
        for segment in WholeSegment::ALL {
            let q: &UnitQuaternion<f64> = &orientations[segment.index()];
            let place = nalgebra::Isometry3::from_parts((origins[segment.index()] * MM).into(), *q);
            // Column by column, then the residual.
            put(&mut data, place.to_homogeneous().as_slice());
            put(&mut data, &[0.0]);
        }
    }
    fill(&mut data);
    // Numbers of blocks take the same room whatever they are.
    let angles: Vec<String> = joints.iter().map(|(_, segment)| angles_label(*segment)).collect();
    let blocks = parameters(rate_hz, frames.len(), &angles, [0; 2]).len() / BLOCK;
    let begin = PARAMETERS + blocks;
    let mut out = header(rate_hz, frames.len(), MARKERS.len() + angles.len(), begin);
    out.extend(parameters(rate_hz, frames.len(), &angles, [begin, begin + data_blocks]));
    out.extend(data);
    out
}

/// Joints by the segments beside them, in the order of [`BodySegment::ALL`]; those of the shoulders where they move.
fn joints(frames: &[Frame]) -> Vec<(BodySegment, BodySegment)> {
    let moves = |shoulder: BodySegment| {
        let torso = BodySegment::Torso.index();
        frames.iter().any(|frame| frame.orientations[shoulder.index()] != frame.orientations[torso])
    };
    let shoulders = BodySegment::SHOULDERS.into_iter().any(moves);
    let segments = BodySegment::ALL.into_iter();
    let shown = segments.filter(|segment| shoulders || !BodySegment::SHOULDERS.contains(segment));
    shown.filter_map(|segment| Some((segment.parent()?, segment))).collect()
}

/// `hip_r_angles`.
fn angles_label(segment: BodySegment) -> String {
    let name = ANGLE_NAMES[of_joint(segment).start];
    format!("{}_angles", name.rsplit_once('_').map_or(name, |(joint, _)| joint))
}

fn header(rate_hz: f64, frames: usize, points: usize, data_block: usize) -> Vec<u8> {
    let mut out = vec![PARAMETERS as u8, 0x50];
    let counted = frames.min(COUNTED) as u16;
    for word in [points as u16, 0, 1, counted, 0] {
        out.extend(word.to_le_bytes());
    }
    // A scale below zero says that points are floats.
    out.extend((-1.0_f32).to_le_bytes());
    out.extend((data_block as u16).to_le_bytes());
    // Analog samples in a frame of points.
    out.extend(1_u16.to_le_bytes());
    out.extend((rate_hz as f32).to_le_bytes());
    fill(&mut out);
    out
}

/// The section of parameters; labels of the joints' angles, and the first blocks of points and rotations are among them.
fn parameters(rate_hz: f64, frames: usize, angles: &[String], [points, rotations]: [usize; 2]) -> Vec<u8> {
    let word = |value: usize| (value as u16).to_le_bytes().to_vec();
    let float = |value: f64| (value as f32).to_le_bytes().to_vec();
    let rate = float(rate_hz);
    let names = WholeSegment::ALL.map(WholeSegment::name);
    let labels: Vec<&str> = MARKERS.into_iter().chain(angles.iter().map(String::as_str)).collect();
    let mut section = Section::default();
    section.group(1, "POINT");
    section.scalar(1, "USED", WORDS, &word(labels.len()));
    if frames <= COUNTED {
        section.scalar(1, "FRAMES", WORDS, &word(frames));
    } else {
        section.scalar(1, "FRAMES", FLOATS, &float(frames as f64));
    }
    section.scalar(1, "DATA_START", WORDS, &word(points));
    section.scalar(1, "SCALE", FLOATS, &float(-1.0));
    section.scalar(1, "RATE", FLOATS, &rate);
    section.texts(1, "UNITS", &["mm"]);
    section.texts(1, "LABELS", &labels);
    section.texts(1, "DESCRIPTIONS", &labels);
    section.texts(1, "ANGLES", &labels[MARKERS.len()..]);
    section.texts(1, "ANGLE_UNITS", &["deg"]);
    section.texts(1, "X_SCREEN", &["+X"]);
    section.texts(1, "Y_SCREEN", &["+Z"]);
    section.group(2, "ANALOG");
    section.scalar(2, "USED", WORDS, &word(0));
    section.scalar(2, "GEN_SCALE", FLOATS, &float(1.0));
    section.scalar(2, "RATE", FLOATS, &rate);
    section.group(3, "TRIAL");
    let [low, high] = [frames % 65_536, frames / 65_536].map(|half| half as u16);
    section.record(3, "ACTUAL_START_FIELD", WORDS, &[2], &[1_u16, 0].map(u16::to_le_bytes).concat());
    section.record(3, "ACTUAL_END_FIELD", WORDS, &[2], &[low, high].map(u16::to_le_bytes).concat());
    section.group(4, "ROTATION");
    section.scalar(4, "USED", WORDS, &word(WHOLE));
    section.scalar(4, "DATA_START", WORDS, &word(rotations));
    section.scalar(4, "RATE", FLOATS, &rate);
    section.scalar(4, "RATIO", WORDS, &word(1));
    section.texts(4, "LABELS", &names);
    section.end()
}

/// Groups and parameters as they follow one another.
#[derive(Default)]
struct Section(Vec<u8>);

impl Section {
    fn group(&mut self, id: i8, name: &str) {
        self.0.extend([name.len() as u8, (-id) as u8]);
        self.0.extend(name.bytes());
        // To the next record from here, and a description of no length.
        self.0.extend(3_u16.to_le_bytes());
        self.0.push(0);
    }

    fn scalar(&mut self, group: i8, name: &str, kind: i8, data: &[u8]) {
        self.record(group, name, kind, &[], data);
    }

    /// One text has one dimension, a list of them two: all as wide as the widest.
    fn texts(&mut self, group: i8, name: &str, texts: &[&str]) {
        let width = texts.iter().map(|text| text.len()).max().unwrap_or(0);
        let data: String = texts.iter().map(|text| format!("{text:width$}")).collect();
        let dimensions = [width as u8, texts.len() as u8];
        let count = if texts.len() > 1 { 2 } else { 1 };
        self.record(group, name, TEXT, &dimensions[..count], data.as_bytes());
    }

    fn record(&mut self, group: i8, name: &str, kind: i8, dimensions: &[u8], data: &[u8]) {
        self.0.extend([name.len() as u8, group as u8]);
        self.0.extend(name.bytes());
        let next = 2 + 1 + 1 + dimensions.len() + data.len() + 1;
        self.0.extend((next as u16).to_le_bytes());
        self.0.extend([kind as u8, dimensions.len() as u8]);
        self.0.extend(dimensions);
        self.0.extend(data);
        self.0.push(0);
    }

    fn end(self) -> Vec<u8> {
        // Four bytes in front: two that nobody reads, how many blocks, and that of processors with the low byte first.
        let mut out = vec![1, 0x50, 0, 84];
        out.extend(self.0);
        out.extend([0, 0]);
        fill(&mut out);
        out[2] = (out.len() / BLOCK) as u8;
        out
    }
}

fn put(out: &mut Vec<u8>, numbers: &[f64]) {
    numbers.iter().for_each(|number| out.extend((*number as f32).to_le_bytes()));
}

/// To the end of a block.
fn fill(out: &mut Vec<u8>) {
    out.resize(out.len().next_multiple_of(BLOCK), 0);
}
