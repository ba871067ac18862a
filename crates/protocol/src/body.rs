//! The body of `body`, written straight from the pipeline's.

use serde::ser::{Serialize, SerializeMap, SerializeSeq, SerializeStruct, Serializer};

use super::message::{Contacts, HeadingSource, LearntEntry, Sole};
use super::{Names, Stamp, round};
use posed_fusion::body::{FootContact, Heading, Learnt};
use posed_stage::layout::SegmentLayout;
use posed_stage::output::{Body, SegmentEstimate, SegmentState};

/// Body of `body`.
pub(super) struct FigureBody<'a> {
    pub(super) stamp: &'a Stamp,
    pub(super) body: &'a Body,
    pub(super) names: &'a Names,
}

impl FigureBody<'_> {
    fn layout(&self) -> &[SegmentLayout] {
        self.names.body(self.body.index).map_or(&[], |layout| &layout.segments)
    }
}

impl Serialize for FigureBody<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (source, held_s) = match self.body.heading {
            Heading::Unknown => (HeadingSource::Unknown, 0.0),
            Heading::Field => (HeadingSource::Field, 0.0),
            Heading::Held(held_s) => (HeadingSource::Held, held_s),
        };
        let mut figure = serializer.serialize_struct("Figure", 10)?;
        figure.serialize_field("t_s", &self.stamp.t_s())?;
        figure.serialize_field("name", self.names.body_name(self.body.index))?;
        figure.serialize_field("heading", &source)?;
        figure.serialize_field("heading_held_s", &round::to(round::RATE, held_s))?;
        figure.serialize_field("heading_sigma_deg", &self.body.heading_sigma_rad.map(degrees))?;
        figure.serialize_field("position_source", &self.body.position_source)?;
        let sigma_m = self.body.position_sigma_m.map(|sigma_m| round::to(round::POSITION, sigma_m));
        figure.serialize_field("position_sigma_m", &sigma_m)?;
        figure.serialize_field("contacts", &self.body.contacts.map(Contacts::from))?;
        figure.serialize_field("segments", &SegmentViews(self))?;
        figure.serialize_field("joints", &Joints(self))?;
        figure.end()
    }
}

struct SegmentViews<'a>(&'a FigureBody<'a>);

impl Serialize for SegmentViews<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let layout = self.0.layout();
        let mut entries = serializer.serialize_seq(Some(layout.len()))?;
        for (layout, segment) in layout.iter().zip(&self.0.body.segments) {
            entries.serialize_element(&SegmentView { layout, segment, names: self.0.names })?;
        }
        entries.end()
    }
}

struct SegmentView<'a> {
    layout: &'a SegmentLayout,
    segment: &'a SegmentEstimate,
    names: &'a Names,
}

impl Serialize for SegmentView<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { layout, segment, names } = self;
        let mut entry = serializer.serialize_struct("SegmentEntry", 8)?;
        entry.serialize_field("name", &*layout.name)?;
        entry.serialize_field("state", &segment.state)?;
        entry.serialize_field("position_m", &segment.position_m.map(|p| round::each(round::POSITION, p)))?;
        let orientation = segment.orientation_wxyz.map(|q| round::each(round::QUATERNION, q));
        entry.serialize_field("orientation_wxyz", &orientation)?;
        entry.serialize_field("sigma_deg", &degrees(segment.sigma_rad))?;
        entry.serialize_field("sensor", &segment.sensor.map(|sensor| names.sensor(sensor)))?;
        entry.serialize_field("fault", &segment.fault)?;
        entry.serialize_field("learnt", &segment.learnt.map(LearntEntry::from))?;
        entry.end()
    }
}

struct Joints<'a>(&'a FigureBody<'a>);

impl Serialize for Joints<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let FigureBody { body, .. } = self.0;
        let layout = self.0.layout();
        let joints = layout.iter().filter(|segment| segment.parent.is_some()).count();
        let mut entries = serializer.serialize_seq(Some(joints))?;
        for (at, (below, segment)) in layout.iter().zip(&body.segments).enumerate() {
            let Some(parent) = below.parent else { continue };
            // The worse of the two; of equals the one below, which moves.
            let (above, over) = (&layout[parent], &body.segments[parent]);
            let (worse, why) = if over.state > segment.state { (over, above) } else { (segment, below) };
            let limited_by = (worse.state != SegmentState::Ok).then_some(&*why.name);
            entries.serialize_element(&JointView {
                at,
                below,
                body,
                state: worse.state,
                limited_by,
                segment,
                over,
            })?;
        }
        entries.end()
    }
}

struct JointView<'a> {
    /// Index of the segment below.
    at: usize,
    below: &'a SegmentLayout,
    body: &'a Body,
    state: SegmentState,
    limited_by: Option<&'a str>,
    segment: &'a SegmentEstimate,
    over: &'a SegmentEstimate,
}

impl Serialize for JointView<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut entry = serializer.serialize_struct("JointEntry", 8)?;
        entry.serialize_field("name", &*self.below.joint)?;
        entry.serialize_field("state", &self.state)?;
        entry.serialize_field("limited_by", &self.limited_by)?;
        entry.serialize_field("angles_deg", &Angles(self))?;
        let sigma_rad = self.segment.sigma_rad.max(self.over.sigma_rad);
        entry.serialize_field("sigma_deg", &degrees(sigma_rad))?;
        entry.serialize_field("angle_sigmas_deg", &Sigmas(self))?;
        let angles = self.below.angles.clone();
        let count = angles.len().min(3);
        let known = self.body.angles_rad[angles.start].is_some();
        let covariance = self.body.spread.covariance_rad2[self.at].map(round::significant);
        let covariance = &covariance[..count * (count + 1) / 2];
        entry.serialize_field("covariance_rad2", &known.then_some(covariance))?;
        let names: [&str; 3] =
            std::array::from_fn(|k| angles.clone().nth(k).map_or("", |angle| self.below.angle(angle)));
        entry.serialize_field("covariance_of", &names[..count])?;
        entry.end()
    }
}

struct Sigmas<'a>(&'a JointView<'a>);

impl Serialize for Sigmas<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let JointView { body, below, .. } = self.0;
        let mut map = serializer.serialize_map(Some(below.angles.len()))?;
        for index in below.angles.clone() {
            let sigma = body.angles_rad[index].map(|_| degrees(body.spread.sigma_rad[index]));
            map.serialize_entry(below.angle(index), &sigma)?;
        }
        map.end()
    }
}

struct Angles<'a>(&'a JointView<'a>);

impl Serialize for Angles<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let range = self.0.below.angles.clone();
        let mut map = serializer.serialize_map(Some(range.len()))?;
        for index in range {
            let angle = self.0.body.angles_rad[index].map(degrees);
            map.serialize_entry(self.0.below.angle(index), &angle)?;
        }
        map.end()
    }
}

impl From<[FootContact; 2]> for Contacts {
    fn from([right, left]: [FootContact; 2]) -> Self {
        let sole = |foot: FootContact| {
            let [heel, toe] = round::each(round::PROBABILITY, foot.sole?);
            Some(Sole { heel, toe })
        };
        let [foot_r, foot_l] = round::each(round::PROBABILITY, [right.foot, left.foot]);
        Self { foot_r, foot_l, sole_r: sole(right), sole_l: sole(left) }
    }
}

impl From<Learnt> for LearntEntry {
    fn from(learnt: Learnt) -> Self {
        let length = learnt.length_m.map(|of_m| round::each(round::POSITION, of_m));
        Self {
            mounting_sigma_deg: degrees(learnt.mounting_sigma_rad),
            turned_deg: degrees(learnt.turned_rad),
            length_m: length.map(|[length_m, _]| length_m),
            length_sigma_m: length.map(|[_, sigma_m]| sigma_m),
        }
    }
}

fn degrees(radians: f64) -> f64 {
    round::to(round::DEGREES, radians.to_degrees())
}
