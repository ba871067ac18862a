//! What wears no sensor, from what does: the most probable posture, and how far people depart from it.
//!
//! In: orientations of the segments that sensors show. Out: those of all segments, with the covariance of what was inferred. Every joint has a habit, from its
//! anatomical range: most probable is the N-pose, and two standard deviations reach three quarters of the way to the limit on either side; what is no axis of the joint hardly turns. A
//! knee thereby is a hinge that does not bend backwards, and a thigh between pelvis and shank is found as far as those show it. Shanks and trunk
//! tend to be upright, and who stands on two legs stands in balance. The maximum a posteriori over all missing segments together is found by
//! Gauss-Newton steps, eliminated from the leaves of the body to its root; equations: `docs/methods/body.md`.

use std::f64::consts::PI;

use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector2, Vector3};

use super::skeleton::{BodySegment, SEGMENTS, Skeleton, upright};
use super::yaw_from_upright;
use posed_geometry::so3::{exp, hat, log, right_jacobian_inverse};

/// Two standard deviations of a joint's habit reach this share of its range, on either side: about as much of it as everyday activities use.
const USED: f64 = 0.75;
/// An axis that a joint does not have is that well known, rad.
const NO_AXIS_RAD: f64 = 0.05;
/// How far from upright trunk and shanks are, where nothing else is known, rad.
const UPRIGHT_RAD: f64 = 0.5;
/// How far the centre of mass is from the middle between the ankles, on the level, of the height: feet are 0.15 of it long.
const BALANCE: f64 = 0.06;
/// Shares of a body's mass times how far down (or up) their segment they sit, about the middle between the ankles (Winter 2009): trunk with arms and head, thigh, shank.
const HELD: [f64; 3] = [0.678 * 0.626, 0.0433 + 0.0465 + 0.0145 - 0.5, 0.0201 + 0.0145 - 0.5];
/// Steps at most, the longest, rad, and the last that is taken, rad.
const STEPS: usize = 12;
const STEP_RAD: f64 = 0.6;
const DONE_RAD: f64 = 1e-4;

/// Orientations of all segments, segment to room, by [`BodySegment::index`], the missing ones as is most probable for upright people; [`upright`] where nothing
/// is known. How far people depart from it: [`super::BodyEstimate::sigma_rad`].
pub fn completed(known: &[Option<UnitQuaternion<f64>>; SEGMENTS]) -> [UnitQuaternion<f64>; SEGMENTS] {
    Inference::of(known).orientations
}

/// All segments, by [`BodySegment::index`].
#[derive(Clone, Debug)]
pub(super) struct Inference {
    /// Segment to room.
    pub(super) orientations: [UnitQuaternion<f64>; SEGMENTS],
    /// Covariance of the rotation that an inferred segment may be wrong by, rad², segment's axes; zero for what is known.
    pub(super) rotations_rad2: [Matrix3<f64>; SEGMENTS],
    /// The same of the rotation between a segment and its parent.
    pub(super) joints_rad2: [Matrix3<f64>; SEGMENTS],
}

impl Inference {
    /// The most probable posture of a body of which these segments are known, segment to room; [`upright`] where none is.
    pub(super) fn of(known: &[Option<UnitQuaternion<f64>>; SEGMENTS]) -> Self {
        let free = BodySegment::ALL
            .map(|segment| known[segment.index()].is_none() && !BodySegment::LEAVES.contains(&segment));
        let mut inference = Self {
            orientations: begun(known),
            rotations_rad2: [Matrix3::zeros(); SEGMENTS],
            joints_rad2: [Matrix3::zeros(); SEGMENTS],
        };
        if free.contains(&true) && known.iter().any(Option::is_some) {
            inference.solve(&free, known);
        }
        for segment in BodySegment::LEAVES.into_iter().filter(|leaf| known[leaf.index()].is_none()) {
            let (at, parent) = (segment.index(), segment.parent().map_or(0, BodySegment::index));
            inference.orientations[at] = inference.orientations[parent];
            inference.joints_rad2[at] = Matrix3::from_diagonal(&Habit::of(segment).variance_rad2());
            inference.rotations_rad2[at] = inference.joints_rad2[at] + inference.rotations_rad2[parent];
        }
        inference
    }

    /// What is expected of errors of what was inferred, root mean square about an axis, rad: those of the nearest segment above that is known, or of the first that
    /// is, come with it. Left alone where nothing is known.
    pub(super) fn judge(
        &self,
        known: &[Option<UnitQuaternion<f64>>; SEGMENTS],
        sigma_rad: &mut [f64; SEGMENTS],
    ) {
        let is_known = |segment: &BodySegment| known[segment.index()].is_some();
        let Some(first) = Skeleton::PARENTS_FIRST.into_iter().find(is_known) else { return };
        for segment in BodySegment::ALL.into_iter().filter(|segment| !is_known(segment)) {
            let above =
                std::iter::successors(segment.parent(), |s| s.parent()).find(is_known).unwrap_or(first);
            let own_rad2 = self.rotations_rad2[segment.index()].trace() / 3.0;
            sigma_rad[segment.index()] = libm::hypot(own_rad2.sqrt(), sigma_rad[above.index()]).min(PI);
        }
    }

    /// Segments beside joints that lie between two that are known, segment to room: these joints are known better than by their habit alone. Nothing is
    /// inferred where a sensor is worn.
    pub(super) fn between(
        &self,
        known: &[Option<UnitQuaternion<f64>>; SEGMENTS],
        worn: &[bool; SEGMENTS],
    ) -> [Option<UnitQuaternion<f64>>; SEGMENTS] {
        let between = joints_between(&known.map(|q| q.is_some()));
        let mut shown = *known;
        for segment in BodySegment::ALL {
            let Some(parent) = segment.parent() else { continue };
            if between[segment.index()] {
                for at in [segment, parent].map(BodySegment::index).into_iter().filter(|at| !worn[*at]) {
                    shown[at] = Some(self.orientations[at]);
                }
            }
        }
        shown
    }

    fn solve(&mut self, free: &[bool; SEGMENTS], known: &[Option<UnitQuaternion<f64>>; SEGMENTS]) {
        for _ in 0..STEPS {
            let mut system = System::of(&self.orientations, free, known, false);
            system.eliminate(free);
            if system.step(free, &mut self.orientations) < DONE_RAD {
                break;
            }
        }
        let mut system = System::of(&self.orientations, free, known, true);
        system.eliminate(free);
        for segment in Skeleton::PARENTS_FIRST {
            let i = segment.index();
            let own = if free[i] { system.inverse[i] } else { Matrix3::zeros() };
            let Some(parent) = segment.parent().map(BodySegment::index) else {
                self.rotations_rad2[i] = own;
                continue;
            };
            let above_rad2 = self.rotations_rad2[parent];
            let follows = if free[i] { -own * system.coupling[i] } else { Matrix3::zeros() };
            let back = (self.orientations[i].inverse() * self.orientations[parent]).to_rotation_matrix();
            let turned = follows - back.matrix();
            self.rotations_rad2[i] = own + follows * above_rad2 * follows.transpose();
            self.joints_rad2[i] = own + turned * above_rad2 * turned.transpose();
        }
    }
}

/// Whether the joint above each segment lies between two that are known, by [`BodySegment::index`]: its angles are then known better than by habit alone.
pub fn joints_between(known: &[bool; SEGMENTS]) -> [bool; SEGMENTS] {
    let mut below = known.map(usize::from);
    for segment in Skeleton::PARENTS_FIRST.into_iter().rev() {
        if let Some(parent) = segment.parent() {
            below[parent.index()] += below[segment.index()];
        }
    }
    let all = below[BodySegment::Pelvis.index()];
    below.map(|count| 0 < count && count < all)
}

/// Where the search begins: as what a segment hangs on, or half way between that and what is known below.
fn begun(known: &[Option<UnitQuaternion<f64>>; SEGMENTS]) -> [UnitQuaternion<f64>; SEGMENTS] {
    let of = |segment: BodySegment| known[segment.index()];
    let mut all = [upright(); SEGMENTS];
    for segment in Skeleton::PARENTS_FIRST {
        let below =
            || BodySegment::ALL.into_iter().find_map(|s| of(s).filter(|_| s.parent() == Some(segment)));
        all[segment.index()] = of(segment).unwrap_or_else(|| match segment.parent() {
            Some(parent) => {
                let above = all[parent.index()];
                let limb = segment.side() != 0.0;
                below().filter(|_| limb).map_or(above, |q| above * exp(&(log(&(above.inverse() * q)) * 0.5)))
            }
            None => of(BodySegment::Torso).unwrap_or_else(|| {
                let facing_rad =
                    Skeleton::PARENTS_FIRST.into_iter().find_map(of).map_or(0.0, |q| yaw_from_upright(&q));
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), facing_rad) * upright()
            }),
        });
    }
    all
}

/// How far a joint's rotation vector departs from the N-pose's, one standard deviation to the negative and to the positive side of each of its axes, rad.
struct Habit([[f64; 2]; 3]);

impl Habit {
    /// Of the joint above a segment. Ranges in degrees about x, y and z of a right joint: American Academy of Orthopaedic Surgeons 1965; the spine's from White & Panjabi 1990, the collar bone's from Lucas 1973.
    fn of(segment: BodySegment) -> Self {
        use BodySegment as B;
        let [x, y, z] = match segment {
            B::Pelvis => [[0.0; 2]; 3],
            B::Torso => [[-35.0, 35.0], [-45.0, 45.0], [-80.0, 25.0]],
            B::Head => [[-45.0, 45.0], [-60.0, 60.0], [-45.0, 45.0]],
            B::UpperArmR | B::UpperArmL => [[-180.0, 30.0], [-90.0, 70.0], [-60.0, 180.0]],
            B::ForearmR | B::ForearmL => [[0.0; 2], [-80.0, 80.0], [0.0, 150.0]],
            B::HandR | B::HandL => [[-70.0, 80.0], [0.0; 2], [-30.0, 20.0]],
            B::ThighR | B::ThighL => [[-45.0, 30.0], [-45.0, 45.0], [-30.0, 120.0]],
            B::ShankR | B::ShankL => [[0.0; 2], [0.0; 2], [-135.0, 0.0]],
            B::FootR | B::FootL => [[-15.0, 35.0], [-15.0, 15.0], [-50.0, 20.0]],
            B::ShoulderR | B::ShoulderL => [[-35.0, 5.0], [-17.5, 17.5], [0.0, 50.0]],
        };
        let sides = if segment.side() < 0.0 { [x, y].map(|[low, high]| [-high, -low]) } else { [x, y] };
        let [x, y] = sides;
        Self(
            [x, y, z].map(|range| {
                range.map(|limit: f64| (0.5 * USED * limit.abs().to_radians()).max(NO_AXIS_RAD))
            }),
        )
    }

    /// Weights of a rotation vector, rad⁻², each by the side that it departs to.
    fn weights(&self, rotation_rad: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| self.0[axis][usize::from(rotation_rad[axis] > 0.0)].powi(-2))
    }

    /// Mean square departure from the N-pose about each axis, rad²: of a normal distribution that is broader on one side.
    fn variance_rad2(&self) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| {
            let [low, high] = self.0[axis];
            (low.powi(3) + high.powi(3)) / (low + high)
        })
    }
}

/// Normal equations of the missing segments' small rotations, segment's axes: the information of each, its gradient, and how it is coupled with its parent's.
struct System {
    information: [Matrix3<f64>; SEGMENTS],
    gradient: [Vector3<f64>; SEGMENTS],
    /// Rows of the segment, columns of its parent; zero where the parent is known.
    coupling: [Matrix3<f64>; SEGMENTS],
    inverse: [Matrix3<f64>; SEGMENTS],
}

impl System {
    /// About a posture; `judged`: for the covariance of what is found, from which a habit's broader side must not be missing, and without the balance, which ties
    /// the legs together.
    fn of(
        all: &[UnitQuaternion<f64>; SEGMENTS],
        free: &[bool; SEGMENTS],
        known: &[Option<UnitQuaternion<f64>>; SEGMENTS],
        judged: bool,
    ) -> Self {
        let mut system = Self {
            information: [Matrix3::zeros(); SEGMENTS],
            gradient: [Vector3::zeros(); SEGMENTS],
            coupling: [Matrix3::zeros(); SEGMENTS],
            inverse: [Matrix3::zeros(); SEGMENTS],
        };
        for segment in BodySegment::ALL {
            let i = segment.index();
            let Some(parent) = segment.parent().map(BodySegment::index) else { continue };
            let hangs = known[i].is_none() && !free[i];
            if hangs || !(free[i] || free[parent]) {
                continue;
            }
            let rotation = all[parent].inverse() * all[i];
            let rotation_rad = log(&rotation);
            let habit = Habit::of(segment);
            let weights =
                if judged { habit.variance_rad2().map(f64::recip) } else { habit.weights(&rotation_rad) };
            let own = right_jacobian_inverse(&rotation_rad);
            let above = -own * rotation.inverse().to_rotation_matrix().matrix();
            let weighted = Matrix3::from_diagonal(&weights);
            let pull = weights.component_mul(&rotation_rad);
            for (at, by) in [(i, own), (parent, above)] {
                if free[at] {
                    system.information[at] += by.transpose() * weighted * by;
                    system.gradient[at] += by.transpose() * pull;
                }
            }
            if free[i] && free[parent] {
                system.coupling[i] = own.transpose() * weighted * above;
            }
        }
        let upright = [BodySegment::Torso, BodySegment::Pelvis, BodySegment::ShankR, BodySegment::ShankL];
        for i in upright.map(BodySegment::index).into_iter().filter(|i| free[*i]) {
            let up = all[i].inverse() * Vector3::z();
            system.add(i, &hat(&up), &(up - Vector3::y()), UPRIGHT_RAD);
        }
        if !judged {
            system.balance(all, free, known);
        }
        system
    }

    fn add<const N: usize>(
        &mut self,
        at: usize,
        by: &SMatrix<f64, N, 3>,
        residual: &SMatrix<f64, N, 1>,
        sigma: f64,
    ) {
        self.information[at] += by.transpose() * by / sigma.powi(2);
        self.gradient[at] += by.transpose() * residual / sigma.powi(2);
    }

    /// Who stands on both legs has the centre of mass above the middle between the ankles; thighs that are missing make it so.
    fn balance(
        &mut self,
        all: &[UnitQuaternion<f64>; SEGMENTS],
        free: &[bool; SEGMENTS],
        known: &[Option<UnitQuaternion<f64>>; SEGMENTS],
    ) {
        let shanks = [BodySegment::ShankR, BodySegment::ShankL].map(BodySegment::index);
        let thighs = [BodySegment::ThighR, BodySegment::ThighL].map(BodySegment::index);
        if shanks.iter().any(|shank| known[*shank].is_none()) {
            return;
        }
        let skeleton = Skeleton::from_height(1.0);
        let [trunk, thigh, shank] = HELD;
        let mut centre = all[BodySegment::Torso.index()] * Vector3::y() * (trunk * skeleton.trunk_m);
        for side in 0..2 {
            centre -= all[thighs[side]] * Vector3::y() * (thigh * skeleton.thigh_m);
            centre -= all[shanks[side]] * Vector3::y() * (shank * skeleton.shank_m);
        }
        let residual = Vector2::new(centre.x, centre.y);
        for i in thighs.into_iter().filter(|thigh| free[*thigh]) {
            let by = all[i].to_rotation_matrix() * hat(&Vector3::y()) * (thigh * skeleton.thigh_m);
            self.add(i, &by.fixed_rows::<2>(0).into_owned(), &residual, BALANCE);
        }
    }

    /// From the leaves to the root.
    fn eliminate(&mut self, free: &[bool; SEGMENTS]) {
        for segment in Skeleton::PARENTS_FIRST.into_iter().rev().filter(|segment| free[segment.index()]) {
            let i = segment.index();
            // Every joint has a habit about each axis.
            self.inverse[i] = self.information[i].try_inverse().unwrap_or_default();
            if let Some(parent) = segment.parent().map(BodySegment::index) {
                let shares = self.coupling[i].transpose() * self.inverse[i];
                self.information[parent] -= shares * self.coupling[i];
                self.gradient[parent] -= shares * self.gradient[i];
            }
        }
    }

    /// From the root to the leaves; the longest step that was taken, rad.
    fn step(&self, free: &[bool; SEGMENTS], all: &mut [UnitQuaternion<f64>; SEGMENTS]) -> f64 {
        let mut steps = [Vector3::zeros(); SEGMENTS];
        let mut longest = 0.0_f64;
        for segment in Skeleton::PARENTS_FIRST.into_iter().filter(|segment| free[segment.index()]) {
            let i = segment.index();
            let above = segment.parent().map_or_else(Vector3::zeros, |parent| steps[parent.index()]);
            steps[i] = -self.inverse[i] * (self.gradient[i] + self.coupling[i] * above);
            longest = longest.max(steps[i].norm());
        }
        // All of them are shortened alike, so that it stays a descent.
        let share = (STEP_RAD / longest.max(STEP_RAD)).min(1.0);
        for (q, step) in all.iter_mut().zip(&steps) {
            *q *= exp(&(step * share));
        }
        longest
    }
}
