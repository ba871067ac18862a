//! The skeleton for programs that speak VMC (Virtual Motion Capture) over OSC: avatars of the Unity humanoid kind.
//!
//! What comes in: the body and the frames of the pipeline. What goes out: datagrams, each complete in itself. What it never does:
//! send a bone that sensors do not show, own a socket.
//!
//! # Axes
//! The room (right-handed, z up) becomes Unity's (left-handed, y up, z forward) by (x, y, z) -> (x, z, y), M with determinant -1;
//! rotations R become M R Mᵀ: the vector part v of the quaternion becomes -M v. A bone's rotation is measured from the T-pose of
//! a figure that looks along Unity's z (arms level, palms down), relative to its parent bone.

mod bones;
#[cfg(test)]
mod tests;

use nalgebra::{Isometry3, Rotation3, UnitQuaternion, Vector3};
use posed_drivers::Timestamp;
use rosc::{OscBundle, OscMessage, OscPacket, OscTime, OscType, encoder};

use self::bones::Bone;
use crate::rate::Rate;
use posed_fusion::body::Skeleton;
use posed_geometry::isometry;
use posed_stage::layout::skeleton_of;
use posed_stage::output::{Body, Estimate};
use posed_stage::{BodyIndex, Stage, VmcBones};

/// Port on which programs listen by custom.
pub const DEFAULT_TARGET: &str = "127.0.0.1:39539";
/// Frames per second unless the stage file specifies otherwise.
pub const DEFAULT_RATE_HZ: f64 = 60.0;
/// A body that has not come for so long does not come, s.
const BODY_S: f64 = 0.25;
/// Largest datagram, bytes: below what an Ethernet frame holds.
const DATAGRAM: usize = 1400;
/// What a bundle of nothing takes, bytes, and what each message takes beside its own bytes.
const BUNDLE: usize = 16;
const ELEMENT: usize = 4;
/// "At once".
const NOW: OscTime = OscTime { seconds: 0, fractional: 1 };

/// Turns bodies into datagrams.
#[derive(Clone, Debug)]
pub struct Publisher {
    body: BodyIndex,
    skeleton: Option<Skeleton>,
    /// Which bones a body has.
    bones: fn(&Body, &Skeleton, UnitQuaternion<f64>, f64) -> Vec<Bone>,
    /// From the room to what is sent: the rotation that the stage file asks for.
    heading: UnitQuaternion<f64>,
    /// Lengths of the avatar over those of the person.
    scale: f64,
    /// Names of the sensors that are sent as trackers.
    trackers: Vec<(usize, String)>,
    rate: Rate,
    /// When the latest body came, or the first frame that waited for one, s.
    body_s: Option<f64>,
    /// The newest good sensors, in the room.
    sensors: Vec<(usize, Isometry3<f64>)>,
}

impl Publisher {
    /// For a body of a stage, as `[vmc]` of its file has it, with the trackers that nobody else wears. Bones need the height of the body in the stage file; without
    /// it none are sent.
    pub fn new(stage: &Stage, body: BodyIndex, settings: &posed_stage::Vmc) -> Self {
        let worn = stage.bodies.get(usize::from(body));
        let person_m = worn.and_then(|body| body.height_m);
        let scale = settings.height_m.zip(person_m).map_or(1.0, |(avatar_m, person_m)| avatar_m / person_m);
        let mut trackers = if settings.trackers { stage.magnetic_indices() } else { Vec::new() };
        trackers.retain(|at| stage.wearer_of(&stage.sensors[*at]).is_none_or(|wearer| wearer == body));
        Self {
            body,
            skeleton: worn.and_then(skeleton_of),
            bones: match settings.bones {
                VmcBones::Required => bones::of,
                VmcBones::All => bones::all,
            },
            heading: Rotation3::from_axis_angle(&Vector3::z_axis(), settings.heading_deg.to_radians()).into(),
            scale,
            trackers: trackers.into_iter().map(|at| (at, stage.sensors[at].name.clone())).collect(),
            rate: Rate::every(1.0 / settings.rate_hz.unwrap_or(DEFAULT_RATE_HZ)),
            body_s: None,
            sensors: Vec::new(),
        }
    }

    /// Gives `emit` the datagrams of a body, if it is this one's and is due by the rate: the bones that sensors show, relative to their parents, in
    /// Unity's axes, m, and the trackers of the newest frame. Where no bone is shown the avatar counts as not loaded.
    pub fn body(&mut self, body: &Body, emit: impl FnMut(&[u8])) {
        if body.index != self.body {
            return;
        }
        self.body_s = Some(body.t_valid.as_secs_f64());
        if !self.rate.is_due(body.t_valid.as_secs_f64()) {
            return;
        }
        let bones = match &self.skeleton {
            Some(skeleton) => (self.bones)(body, skeleton, self.heading, self.scale),
            None => Vec::new(),
        };
        self.emit(body.t_valid, &bones, emit);
    }

    /// Takes over the sensors of a frame whose poses may be used as good. Gives `emit` their datagrams, if they are due and no
    /// body brings them: on a stage without the height of one, or once none has come for a quarter of a second, as before an
    /// alignment.
    pub fn frame(&mut self, estimate: &Estimate, emit: impl FnMut(&[u8])) {
        self.sensors.clear();
        for &(at, _) in &self.trackers {
            let pose = estimate.sensors.get(at).and_then(|sensor| sensor.usable_pose());
            let pose = pose.and_then(|pose| isometry(pose.position_m?, pose.orientation_wxyz));
            self.sensors.extend(pose.map(|pose| (at, pose)));
        }
        let t_s = estimate.t_valid.as_secs_f64();
        let no_body = t_s - *self.body_s.get_or_insert(t_s) > BODY_S;
        if (self.skeleton.is_none() || no_body) && self.rate.is_due(t_s) {
            self.emit(estimate.t_valid, &[], emit);
        }
    }

    /// To be called now and then with the stage time, s: if what is due has not come for more than 1 s, forgets the trackers and
    /// gives `emit` a datagram that reports no bones.
    pub fn look(&mut self, t_s: f64, emit: impl FnMut(&[u8])) {
        // Somewhat more than the largest distance of two frames.
        if self.rate.is_overdue(t_s, 1.0) {
            self.sensors.clear();
            self.emit(Timestamp::from_secs_f64(t_s), &[], emit);
        }
    }

    /// Lets time start anew, as after a jump in a replay, and forgets the trackers.
    pub fn rewind(&mut self) {
        self.rate.rewind();
        self.body_s = None;
        self.sensors.clear();
    }

    fn emit(&self, t: Timestamp, bones: &[Bone], mut emit: impl FnMut(&[u8])) {
        let t_s = (t.as_nanos() as f64 * 1e-9) as f32;
        let loaded = i32::from(!bones.is_empty());
        let mut messages = vec![
            message("/VMC/Ext/OK", [OscType::Int(loaded)]),
            message("/VMC/Ext/T", [OscType::Float(t_s)]),
        ];
        if loaded == 1 {
            messages.push(placed("/VMC/Ext/Root/Pos", "root", Vector3::zeros(), UnitQuaternion::identity()));
        }
        messages.extend(
            bones.iter().map(|bone| placed("/VMC/Ext/Bone/Pos", bone.name, bone.offset_m, bone.rotation)),
        );
        for (at, pose) in &self.sensors {
            let Some((_, name)) = self.trackers.iter().find(|(tracker, _)| tracker == at) else { continue };
            let position_m = unity_vector(self.heading * pose.translation.vector) * self.scale;
            let rotation = unity_rotation(self.heading * pose.rotation);
            messages.push(placed("/VMC/Ext/Tra/Pos", name, position_m, rotation));
        }
        bundles(messages, &mut emit);
    }
}

/// Positions in Unity's axes.
fn unity_vector(room: Vector3<f64>) -> Vector3<f64> {
    Vector3::new(room.x, room.z, room.y)
}

/// Rotations in Unity's axes.
fn unity_rotation(room: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let vector = -unity_vector(room.imag());
    UnitQuaternion::new_unchecked(nalgebra::Quaternion::from_parts(room.w, vector))
}

fn message(address: &str, args: impl Into<Vec<OscType>>) -> OscMessage {
    OscMessage { addr: address.to_owned(), args: args.into() }
}

/// Name, position, rotation with the scalar last.
fn placed(address: &str, name: &str, position_m: Vector3<f64>, rotation: UnitQuaternion<f64>) -> OscMessage {
    let numbers = position_m.iter().chain(rotation.coords.iter()).map(|value| OscType::Float(*value as f32));
    message(address, std::iter::once(OscType::String(name.to_owned())).chain(numbers).collect::<Vec<_>>())
}

/// Packs messages into as few datagrams as they need.
fn bundles(messages: Vec<OscMessage>, emit: &mut impl FnMut(&[u8])) {
    let mut content = Vec::new();
    let mut bytes = BUNDLE;
    let mut send = |content: &mut Vec<OscPacket>| {
        let bundle = OscBundle { timetag: NOW, content: std::mem::take(content) };
        // Names without NUL cannot be refused, and stage files hold none.
        if let Ok(datagram) = encoder::encode(&OscPacket::Bundle(bundle)) {
            emit(&datagram);
        }
    };
    for message in messages {
        let packet = OscPacket::Message(message);
        let length = ELEMENT + encoder::encode(&packet).map_or(0, |bytes| bytes.len());
        if bytes + length > DATAGRAM && !content.is_empty() {
            send(&mut content);
            bytes = BUNDLE;
        }
        bytes += length;
        content.push(packet);
    }
    send(&mut content);
}
