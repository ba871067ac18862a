use super::calibrate::calibrate;
use super::guide::Guide;
use super::live::LiveChain;
use super::*;
use posed_geometry::{GRAVITY_M_S2, so3};

const RATE_HZ: f64 = 100.0;

/// Three segments on two parallel hinges, sensors askew, gyros biased, no magnetometer.
fn recording() -> (Vec<ChainSegment>, Vec<Epoch>, Vec<[f64; 2]>) {
    recording_held(&UnitQuaternion::identity())
}

/// The same, held turned in the room.
fn recording_held(held: &UnitQuaternion<f64>) -> (Vec<ChainSegment>, Vec<Epoch>, Vec<[f64; 2]>) {
    let mounts = [
        so3::exp(&Vector3::new(0.4, -0.9, 0.3)),
        so3::exp(&Vector3::new(-1.2, 0.5, 2.0)),
        so3::exp(&Vector3::new(1.9, 0.2, -0.7)),
    ];
    let levers = [Vector3::new(0.0, 0.2, 0.03), Vector3::new(0.02, -0.15, 0.0), Vector3::new(0.0, -0.2, 0.0)];
    let angles = |t: f64| {
        let grow = (t / 4.0).min(1.0);
        [grow * (0.7 - 0.7 * libm::cos(1.3 * t)), grow * (0.6 - 0.6 * libm::cos(1.9 * t))]
    };
    let poses = |t: f64| {
        let grow = (t / 4.0).min(1.0);
        let upright = so3::exp(&(Vector3::x() * std::f64::consts::FRAC_PI_2));
        let whole = so3::exp(
            &(Vector3::new(libm::sin(0.9 * t), 0.6 * libm::sin(0.7 * t), 0.8 * libm::sin(1.1 * t)) * grow),
        ) * held
            * upright;
        let [a, b] = angles(t);
        let second = whole * so3::exp(&(Vector3::z() * a));
        let third = second * so3::exp(&(Vector3::z() * b));
        let knee = Vector3::new(0.2 * libm::sin(1.7 * t), 0.2 * libm::cos(1.3 * t), 1.0) * grow;
        let ankle = knee + second * Vector3::new(0.0, -0.4, 0.0);
        [
            (whole, knee + whole * levers[0]),
            (second, knee + second * levers[1]),
            (third, ankle + third * levers[2]),
        ]
    };
    let segments = vec![
        ChainSegment { name: "a".into(), hinge: None },
        ChainSegment { name: "b".into(), hinge: Some((0, "one".into())) },
        ChainSegment { name: "c".into(), hinge: Some((1, "two".into())) },
    ];
    let h = 1e-3;
    let (mut epochs, mut truth) = (Vec::new(), Vec::new());
    for k in 0..(60.0 * RATE_HZ) as usize {
        let t = k as f64 / RATE_HZ;
        let (before, now, after) = (poses(t - h), poses(t), poses(t + h));
        let samples = (0..3)
            .map(|i| {
                let angular_velocity_rad_s = so3::log(&(before[i].0.inverse() * after[i].0)) / (2.0 * h);
                let accel =
                    (after[i].1 + before[i].1 - now[i].1 * 2.0) / (h * h) + Vector3::z() * GRAVITY_M_S2;
                Some(ImuSample {
                    gyro_rad_s: mounts[i].inverse() * angular_velocity_rad_s
                        + Vector3::new(0.004, -0.003, 0.005),
                    accel_m_s2: mounts[i].inverse() * (now[i].0.inverse() * accel),
                    mag: None,
                })
            })
            .collect();
        epochs.push(Epoch { t_s: t, samples });
        truth.push(angles(t));
    }
    (segments, epochs, truth)
}

#[test]
fn a_chain_is_solved_from_its_movement_alone() {
    let (segments, epochs, truth) = recording();
    let solved = solve(&segments, &epochs).unwrap();
    for joint in 0..2 {
        let sum: f64 = solved
            .poses
            .iter()
            .zip(&truth)
            .map(|(pose, truth)| (pose.flexion_rad[joint + 1] - truth[joint]).powi(2))
            .sum();
        let rms = (sum / truth.len() as f64).sqrt().to_degrees();
        assert!(rms < 1.5, "joint {joint}: {rms} degrees");
    }
}

/// A hinge that stands upright for the first seconds gives no information about the heading between its sensors meanwhile.
#[test]
fn an_axis_that_stands_upright_at_first_is_solved_from_the_first_sample() {
    let rotation = so3::exp(&(Vector3::x() * -std::f64::consts::FRAC_PI_2));
    let (segments, epochs, truth) = recording_held(&rotation);
    let solved = solve(&segments, &epochs).unwrap();
    for (k, (pose, truth)) in solved.poses.iter().zip(&truth).enumerate() {
        let off = (pose.flexion_rad[1] - truth[0]).to_degrees();
        assert!(off.abs() < 6.0, "{off} degrees off at epoch {k}");
    }
}

/// Sensors in foam: they play by some degrees at 8 Hz, which their rates feel ten times as much as their orientations.
#[test]
fn soft_straps_do_not_spoil_the_axis() {
    let (segments, mut epochs, truth) = recording();
    for (k, epoch) in epochs.iter_mut().enumerate() {
        let phase = std::f64::consts::TAU * 8.0 * k as f64 / RATE_HZ;
        for (i, sample) in epoch.samples.iter_mut().flatten().enumerate() {
            let axis = Vector3::new(libm::cos(i as f64), 0.7, libm::sin(i as f64)).normalize();
            sample.gyro_rad_s += axis * (1.5 * libm::sin(phase + i as f64));
        }
    }
    let solved = solve(&segments, &epochs).unwrap();
    for joint in 0..2 {
        let squares = solved.poses.iter().zip(&truth);
        let sum: f64 =
            squares.map(|(pose, truth)| (pose.flexion_rad[joint + 1] - truth[joint]).powi(2)).sum();
        let rms = (sum / truth.len() as f64).sqrt().to_degrees();
        assert!(rms < 3.5, "joint {joint}: {rms} degrees");
        // What plays is said.
        let stated: f64 = solved.poses.iter().map(|pose| pose.sigma_rad[joint + 1].powi(2)).sum();
        let stated = (stated / truth.len() as f64).sqrt().to_degrees();
        println!(
            "joint {joint}: wrong by {rms:.2}, stated {stated:.2}, play {:?}",
            solved.play_deg[joint + 1]
        );
        assert!((0.7..4.0).contains(&(stated / rms)), "joint {joint}: {stated} {rms}");
    }
}

#[test]
fn missing_samples_are_bridged() {
    let (segments, mut epochs, truth) = recording();
    for (k, epoch) in epochs.iter_mut().enumerate() {
        if k % 7 == 3 {
            epoch.samples[1] = None;
        }
    }
    let solved = solve(&segments, &epochs).unwrap();
    let worst = solved
        .poses
        .iter()
        .zip(&truth)
        .map(|(pose, truth)| (pose.flexion_rad[1] - truth[0]).abs().to_degrees())
        .fold(0.0, f64::max);
    assert!(worst < 6.0, "{worst} degrees");
}

#[test]
fn a_chain_that_does_not_move_names_the_joint() {
    let (segments, mut epochs, _) = recording();
    let still = epochs[0].clone();
    for epoch in &mut epochs {
        epoch.samples.clone_from(&still.samples);
    }
    let error = solve(&segments, &epochs).unwrap_err();
    assert!(error.to_string().starts_with("joint `one`: the movement shows too little"), "{error}");
}

#[test]
fn times_must_rise() {
    let (segments, mut epochs, _) = recording();
    epochs[10].t_s = epochs[9].t_s;
    assert!(matches!(solve(&segments, &epochs), Err(ChainError::Time { .. })));
}

/// Calibrated from its first half minute, the chain is followed without hindsight nearly as well as from the whole file; and the
/// angles' errors are what is stated.
#[test]
fn a_chain_that_was_calibrated_is_followed_live() {
    let (segments, epochs, truth) = recording();
    let half = epochs.len() / 2;
    let calibration = calibrate(&segments, &epochs[..half]).unwrap();
    let offline = solve(&segments, &epochs).unwrap();
    let parents: Vec<_> = segments.iter().map(|s| s.hinge.as_ref().map(|(parent, _)| *parent)).collect();
    let mut live = LiveChain::new(&parents, &calibration).unwrap();
    let mut sums = [[0.0; 3]; 2];
    let mut count = 0.0;
    for (k, epoch) in epochs.iter().enumerate() {
        for (segment, sample) in epoch.samples.iter().enumerate() {
            live.push(segment, epoch.t_s, sample.as_ref().unwrap());
        }
        live.advance(epoch.t_s);
        if k < half {
            continue;
        }
        count += 1.0;
        for (joint, sums) in sums.iter_mut().enumerate() {
            let pose = live.pose(joint + 1, epoch.t_s).unwrap();
            let off = wrapped_rad(pose.flexion_rad - truth[k][joint]);
            let file = wrapped_rad(offline.poses[k].flexion_rad[joint + 1] - truth[k][joint]);
            for (sum, value) in sums.iter_mut().zip([off, file, pose.sigma_rad]) {
                *sum += value * value;
            }
        }
    }
    assert!(live.is_settled(0.01));
    for (joint, sums) in sums.iter().enumerate() {
        let [live, file, stated] = sums.map(|sum| (sum / count).sqrt().to_degrees());
        let quality_deg = calibration.segments[joint + 1].hinge.unwrap().quality_deg;
        println!(
            "joint {joint}: live {live:.2}, file {file:.2}, stated {stated:.2}, quality {quality_deg:.2} degrees"
        );
        assert!(live < 2.0 && live < 2.5 * file + 0.5, "joint {joint}: live {live}, file {file} degrees");
        assert!((0.4..4.0).contains(&(stated / live)), "joint {joint}: {live} and stated {stated} degrees");
        assert!(quality_deg < 3.0, "joint {joint}: {quality_deg} degrees");
    }
    // After a gap the headings are unknown and found again.
    let last = epochs.last().unwrap();
    for (segment, sample) in last.samples.iter().enumerate() {
        live.push(segment, last.t_s + 2.0, sample.as_ref().unwrap());
    }
    live.advance(last.t_s + 2.0);
    assert!(!live.is_settled(0.01) && live.is_settled(0.1));
    assert_eq!(live.pose(1, last.t_s + 4.0), None, "silent for too long");
}

#[test]
fn a_guide_waits_for_a_posture_and_then_for_half_a_minute_of_movement() {
    let (_, epochs, _) = recording();
    let mut guide = Guide::default();
    assert!(guide.prompt().unwrap().starts_with("1 of 2"));
    let shifted = |t_s: f64, epoch: &Epoch| Epoch { t_s, ..epoch.clone() };
    // It moves, then it rests, then it moves for long enough.
    for (k, epoch) in epochs[2000..2300].iter().enumerate() {
        guide.push(shifted(k as f64 * 0.01, epoch));
    }
    assert!(guide.prompt().unwrap().starts_with("1 of 2"));
    for k in 0..200 {
        guide.push(shifted(3.0 + f64::from(k) * 0.01, &epochs[0]));
    }
    assert!(guide.prompt().unwrap().starts_with("2 of 2"));
    let (mut k, begun) = (0, guide.recorded().len());
    while guide.prompt().is_some() {
        guide.push(shifted(5.0 + k as f64 * 0.01, &epochs[1000 + k % 4000]));
        k += 1;
    }
    assert!((2900..5000).contains(&k) && begun < 350, "{k} {begun}");
    assert!(guide.recorded().windows(2).all(|pair| pair[0].t_s < pair[1].t_s));
}

/// Both links turn about the hinge alone, and in step: the movement fits many axes, and a calibration says so.
#[test]
fn a_movement_about_the_hinge_alone_shows_no_axis() {
    let (segments, mut epochs, _) = recording();
    for (k, epoch) in epochs.iter_mut().enumerate() {
        let t = k as f64 / RATE_HZ;
        let angle = 0.5 - 0.5 * libm::cos(2.0 * t);
        for (sample, times) in epoch.samples.iter_mut().flatten().zip([1.0, -1.2, 0.9]) {
            let angular_velocity_rad_s = Vector3::z() * (times * libm::sin(2.0 * t));
            let turned = so3::exp(&(Vector3::z() * (times * angle)));
            let wobble = Vector3::new(libm::sin(7.0 * t), libm::cos(9.0 * t), 0.0);
            sample.gyro_rad_s = angular_velocity_rad_s + wobble * 0.05;
            sample.accel_m_s2 = turned.inverse() * Vector3::y() * GRAVITY_M_S2 + wobble * 0.1;
        }
    }
    match calibrate(&segments[..2], &epochs[..3000]) {
        Ok(found) => assert!(found.segments[1].hinge.unwrap().quality_deg > 5.0, "{found:?}"),
        Err(refused) => assert!(matches!(refused, ChainError::Joint { .. }), "{refused}"),
    }
}

/// A leg that walks: thigh and shank swing about an axis that stays level, and turn with the way. Nothing shows then whether the shank bends against
/// the thigh or goes along with it.
#[test]
fn a_walk_in_which_the_axis_stays_level_is_not_believed() {
    let mounts = [Vector3::new(0.4, -0.9, 0.3), Vector3::new(-1.2, 0.5, 2.0)].map(|v| so3::exp(&v));
    let poses = |t: f64| {
        let phase = std::f64::consts::TAU * 0.9 * t;
        let heading = so3::exp(&(Vector3::z() * (0.3 * t)));
        let swing = 0.4 * libm::sin(phase);
        let bend = 0.5 - 0.5 * libm::cos(phase + 0.7);
        [swing, swing - bend].map(|pitch| heading * so3::exp(&(Vector3::y() * pitch)))
    };
    let h = 1e-3;
    let epochs: Vec<Epoch> = (0..(60.0 * RATE_HZ) as usize)
        .map(|k| {
            let t_s = k as f64 / RATE_HZ;
            let (before, now, after) = (poses(t_s - h), poses(t_s), poses(t_s + h));
            let sample = |i: usize| ImuSample {
                gyro_rad_s: mounts[i].inverse() * so3::log(&(before[i].inverse() * after[i])) / (2.0 * h),
                accel_m_s2: mounts[i].inverse() * (now[i].inverse() * Vector3::z()) * GRAVITY_M_S2,
                mag: None,
            };
            Epoch { t_s, samples: vec![Some(sample(0)), Some(sample(1))] }
        })
        .collect();
    let (segments, ..) = recording();
    let solved = solve(&segments[..2], &epochs).unwrap();
    assert_eq!(solved.quality_deg, [None, Some(90.0)]);
    assert!(solved.poses.iter().all(|pose| pose.sigma_rad[1] > 1.5));
}

/// Errors are of the size that is stated, root mean square over the recording; the zero is a posture of a quarter of a second.
#[test]
fn angles_of_a_file_are_as_sure_as_is_said() {
    for rotation in [0.0, -std::f64::consts::FRAC_PI_2] {
        let (segments, epochs, truth) = recording_held(&so3::exp(&(Vector3::x() * rotation)));
        let solved = solve(&segments, &epochs).unwrap();
        for joint in 0..2 {
            let quality_deg = solved.quality_deg[joint + 1].unwrap();
            assert!(quality_deg < 3.0, "joint {joint}: {quality_deg} degrees");
            let of = |(pose, truth): (&ChainPose, &[f64; 2])| {
                let off_rad = pose.flexion_rad[joint + 1] - truth[joint];
                (off_rad / pose.sigma_rad[joint + 1]).powi(2)
            };
            let nees = solved.poses.iter().zip(&truth).map(of).sum::<f64>() / truth.len() as f64;
            println!("held {rotation:.1}, joint {joint}: NEES {nees:.2}, quality {quality_deg:.2}");
            assert!(nees < 3.0, "joint {joint}: {nees}");
        }
    }
}
