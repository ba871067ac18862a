//! The body as MVN's real-time network stream (MXTP), which plug-ins of programs for animation, engines and robots read.
//!
//! What comes in: the body. What goes out: datagrams of one sample, big-endian: positions and quaternions of all 23 segments (type 02), on request as
//! Euler angles (01), joint angles (20), on request how segments move (21, 22) and the centre of mass (24), and the time (25); once a second who it is
//! (12) and how it stands in a T-pose (13). It asks nobody and owns no socket. It sends all 23 segments or none: what no sensor shows is inferred as in files, since receivers drop figures with fewer.
//!
//! # Axes
//! World of all types but 01: the room's, x forward, y left, z up, m. Segments have their origin in the joint above, and in a T-pose with level arms that looks along x
//! no rotation. Type 01 has y up, z forward, x left, and centimetres. Joint angles are degrees about x, y, z of the ISB axes (x forward, y up, z to the right), as
//! extracted in the order Z, X, Y, zero in the N-pose; about x and y mirrored on the left.
//!
//! Layouts after the maker's specification MV0305P; what other readers disagree about is named in `docs/streams.md`.

mod motion;
#[cfg(test)]
mod tests;
mod wire;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use self::motion::{Parabola, Track};
use self::wire::Datagram;
use crate::rate::Rate;
use posed_fusion::body::{BodySegment, Skeleton, WHOLE, WholeSegment, completed, whole, whole_t_pose};
use posed_geometry::{orientation_from_wxyz, so3};
use posed_stage::layout::{color_of, skeleton_of};
use posed_stage::output::Body;
use posed_stage::{BodyIndex, Stage};

/// Port on which programs listen by custom.
pub const DEFAULT_TARGET: &str = "127.0.0.1:9763";
/// Samples per second unless the stage file specifies otherwise.
pub const DEFAULT_RATE_HZ: f64 = 60.0;
/// Who it is and how it stands is sent again after this, s.
const DESCRIBED_S: f64 = 1.0;

/// Turns bodies into datagrams.
#[derive(Clone, Debug)]
pub struct Publisher {
    body: BodyIndex,
    skeleton: Option<Skeleton>,
    name: String,
    color: String,
    character: u8,
    euler: bool,
    kinematics: bool,
    track: Track,
    rate: Rate,
    sample: u32,
    /// When the first sample was, s, and when the last description.
    began_s: Option<f64>,
    described_s: f64,
}

impl Publisher {
    /// For a body of a stage, as `[mvn]` of its file has it: the first has the number that it gives, each further one the next. Without the height of the body in the
    /// stage file nothing is sent.
    pub fn new(stage: &Stage, body: BodyIndex, settings: &posed_stage::Mvn) -> Self {
        let worn = stage.bodies.get(usize::from(body));
        Self {
            body,
            skeleton: worn.and_then(skeleton_of),
            name: match &*stage.bodies {
                [] | [_] => stage.name.clone(),
                _ => worn.map_or_else(String::new, |body| body.name.clone()),
            },
            color: color_of(stage, body)[1..].to_owned(),
            character: settings.character.wrapping_add(body),
            euler: settings.euler,
            kinematics: settings.kinematics,
            track: Track::default(),
            rate: Rate::every(1.0 / settings.rate_hz.unwrap_or(DEFAULT_RATE_HZ)),
            sample: 0,
            began_s: None,
            described_s: f64::NEG_INFINITY,
        }
    }

    /// Gives `emit` the datagrams of a body, if it is this one's, one is due by the rate and its hips are shown.
    pub fn body(&mut self, body: &Body, mut emit: impl FnMut(&[u8])) {
        let Some(skeleton) = self.skeleton.filter(|_| body.index == self.body) else { return };
        let Some(figure) = Figure::of(body, &skeleton) else { return };
        let t_s = body.t_valid.as_secs_f64();
        if self.kinematics {
            self.track.push(t_s, &figure);
        }
        if !self.rate.is_due(t_s) {
            return;
        }
        let began_s = *self.began_s.get_or_insert(t_s);
        let head = wire::Head {
            sample: self.sample,
            time_ms: (1e3 * (t_s - began_s)).round() as u32,
            character: self.character,
        };
        self.sample = self.sample.wrapping_add(1);
        if !(0.0..DESCRIBED_S).contains(&(t_s - self.described_s)) {
            self.described_s = t_s;
            let words = format!("name:{}\nxmid:{}\ncolor:{}\n", self.name, self.character, self.color);
            let mut meta = Datagram::new(12, &head, 1);
            meta.text(&words);
            emit(&meta.finish());
            emit(&rest(&head, &skeleton));
        }
        emit(&figure.pose(&head));
        if self.euler {
            emit(&figure.euler(&head));
        }
        emit(&figure.joint_angles(&head));
        if self.kinematics {
            let parabola = self.track.parabola();
            emit(&figure.linear(&head, &parabola));
            emit(&figure.angular(&head, &parabola));
            let mut mass = Datagram::new(24, &head, 1);
            mass.numbers(motion::centre_of_mass_m(&figure).iter());
            emit(&mass.finish());
        }
        let ms = (1e3 * t_s).round() as u64;
        let (s, min, h) = (ms / 1000 % 60, ms / 60_000 % 60, ms / 3_600_000);
        let mut time = Datagram::new(25, &head, 1);
        time.text(&format!("{:02}:{min:02}:{s:02}.{:03}", h % 24, ms % 1000));
        emit(&time.finish());
    }

    /// Lets time start anew, as after a jump in a replay.
    pub fn rewind(&mut self) {
        self.rate.rewind();
        self.track.clear();
        self.began_s = None;
        self.described_s = f64::NEG_INFINITY;
    }
}

/// How the figure stands in a T-pose above the origin: type 13.
fn rest(head: &wire::Head, skeleton: &Skeleton) -> Vec<u8> {
    let stands_m = Vector3::z() * (skeleton.thigh_m + skeleton.shank_m + skeleton.foot_m);
    let origins_m = skeleton.whole_origins_m(&WholeSegment::ALL.map(whole_t_pose), stands_m);
    let mut datagram = Datagram::new(13, head, WHOLE as u8);
    datagram.count(WHOLE as u32);
    for (segment, at_m) in WholeSegment::ALL.into_iter().zip(&origins_m) {
        datagram.text(name(segment));
        datagram.numbers(at_m.iter());
    }
    // Points on the segments: none.
    datagram.count(0);
    datagram.finish()
}

/// The 23 at one time, by [`WholeSegment::index`].
#[derive(Clone, Debug)]
struct Figure {
    /// Segment to room, as ours.
    orientations: [UnitQuaternion<f64>; WHOLE],
    origins_m: [Vector3<f64>; WHOLE],
}

impl Figure {
    /// `None` where the hips are not shown.
    fn of(body: &Body, skeleton: &Skeleton) -> Option<Self> {
        let shown = |segment: BodySegment| {
            let of = body.segments.get(segment.index()).filter(|of| of.state.is_shown())?;
            orientation_from_wxyz(of.orientation_wxyz?)
        };
        shown(BodySegment::Pelvis)?;
        let pelvis_m = body.segments[BodySegment::Pelvis.index()].position_m?;
        let orientations = whole(&completed(&BodySegment::ALL.map(shown)));
        Some(Self { orientations, origins_m: skeleton.whole_origins_m(&orientations, pelvis_m.into()) })
    }

    /// Each segment's id, origin, and how it is turned since the T-pose, with a real part that is not negative.
    fn segments(&self) -> impl Iterator<Item = (u32, Vector3<f64>, UnitQuaternion<f64>)> + '_ {
        WholeSegment::ALL.into_iter().map(|segment| {
            let at = segment.index();
            let q = self.orientations[at] * whole_t_pose(segment).inverse();
            let q = if q.w < 0.0 { UnitQuaternion::new_unchecked(-q.into_inner()) } else { q };
            (id(segment), self.origins_m[at], q)
        })
    }

    /// Type 02.
    fn pose(&self, head: &wire::Head) -> Vec<u8> {
        let mut datagram = Datagram::new(2, head, WHOLE as u8);
        for (id, at_m, q) in self.segments() {
            datagram.count(id);
            datagram.numbers(at_m.iter().chain([&q.w, &q.i, &q.j, &q.k]));
        }
        datagram.finish()
    }

    /// Type 01.
    fn euler(&self, head: &wire::Head) -> Vec<u8> {
        let y_up = |v: Vector3<f64>| Vector3::new(v.y, v.z, v.x);
        let mut datagram = Datagram::new(1, head, WHOLE as u8);
        for (id, at_m, q) in self.segments() {
            let turned = UnitQuaternion::new_unchecked(Quaternion::from_parts(q.w, y_up(q.imag())));
            let (x, y, z) = turned.euler_angles();
            datagram.count(id);
            datagram.numbers((y_up(at_m) * 100.0).iter().chain(&[x, y, z].map(f64::to_degrees)));
        }
        datagram.finish()
    }

    /// Type 21: places, velocities and accelerations, m and s.
    fn linear(&self, head: &wire::Head, parabola: &Parabola<'_>) -> Vec<u8> {
        let mut datagram = Datagram::new(21, head, WHOLE as u8);
        for (id, at_m, _) in self.segments() {
            let [velocity, acceleration] = parabola.derivatives(|of| of.origins_m[id as usize - 1] - at_m);
            datagram.count(id);
            datagram.numbers(at_m.iter().chain(velocity.iter()).chain(acceleration.iter()));
        }
        datagram.finish()
    }

    /// Type 22: quaternions, angular velocities and accelerations in the room, degrees and s.
    fn angular(&self, head: &wire::Head, parabola: &Parabola<'_>) -> Vec<u8> {
        let mut datagram = Datagram::new(22, head, WHOLE as u8);
        for (id, _, q) in self.segments() {
            let at = id as usize - 1;
            let now = self.orientations[at].inverse();
            let [velocity, acceleration] =
                parabola.derivatives(|of| so3::log(&(of.orientations[at] * now)).map(f64::to_degrees));
            datagram.count(id);
            let turned = [&q.w, &q.i, &q.j, &q.k].into_iter();
            datagram.numbers(turned.chain(velocity.iter()).chain(acceleration.iter()));
        }
        datagram.finish()
    }

    /// Type 20: all joints, parents first, those of the neck before those of the shoulders.
    fn joint_angles(&self, head: &wire::Head) -> Vec<u8> {
        let mut datagram = Datagram::new(20, head, WHOLE as u8 - 1);
        for segment in WholeSegment::ALL {
            let Some(parent) = segment.parent() else { continue };
            let relative = self.orientations[parent.index()].inverse() * self.orientations[segment.index()];
            let m = relative.to_rotation_matrix();
            let x = libm::asin(m[(2, 1)].clamp(-1.0, 1.0));
            let y = libm::atan2(-m[(2, 0)], m[(2, 2)]);
            let z = libm::atan2(-m[(0, 1)], m[(1, 1)]);
            let mirrored = if segment.side() < 0.0 { -1.0 } else { 1.0 };
            // Receivers look at the segments of the points only.
            datagram.count(256 * id(parent));
            datagram.count(256 * id(segment));
            datagram.numbers([mirrored * x, mirrored * y, z].map(f64::to_degrees).iter());
        }
        datagram.finish()
    }
}

fn id(segment: WholeSegment) -> u32 {
    segment.index() as u32 + 1
}

/// As MVN calls it.
fn name(segment: WholeSegment) -> &'static str {
    use WholeSegment as W;
    match segment {
        W::Pelvis => "Pelvis",
        W::L5 => "L5",
        W::L3 => "L3",
        W::T12 => "T12",
        W::T8 => "T8",
        W::Neck => "Neck",
        W::Head => "Head",
        W::ShoulderR => "RightShoulder",
        W::UpperArmR => "RightUpperArm",
        W::ForearmR => "RightForeArm",
        W::HandR => "RightHand",
        W::ShoulderL => "LeftShoulder",
        W::UpperArmL => "LeftUpperArm",
        W::ForearmL => "LeftForeArm",
        W::HandL => "LeftHand",
        W::UpperLegR => "RightUpperLeg",
        W::LowerLegR => "RightLowerLeg",
        W::FootR => "RightFoot",
        W::ToeR => "RightToe",
        W::UpperLegL => "LeftUpperLeg",
        W::LowerLegL => "LeftLowerLeg",
        W::FootL => "LeftFoot",
        W::ToeL => "LeftToe",
    }
}
