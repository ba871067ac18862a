//! The fuzz targets' bodies over the corpus and over seeded bytes: noise sown into messages.

use std::net::SocketAddr;
use std::path::Path;

use posed_drivers::datagram::Datagram;
use posed_drivers::fuzzing::{self, HEAD};
use posed_drivers::slimevr::wire as slime;

use crate::matrix::Noise;

/// A driver's body, and how many samples came out.
type Body = fn(&[u8]) -> usize;

/// An input that leads to the streams: default settings, answers to the set-up where `answers` has a place in the head, then the
/// message again and again in chunks, with time between and some bytes replaced by noise.
fn input(noise: &mut Noise, answers: Option<(usize, u8)>, first: &[u8], message: &[u8]) -> Vec<u8> {
    let mut script = vec![0; HEAD];
    if let Some((place, which)) = answers {
        script[place] = which;
    }
    // Now and then other settings.
    for byte in script.iter_mut().take(if noise.next() < 60 { 8 } else { 0 }) {
        *byte = noise.next();
    }
    let say = |script: &mut Vec<u8>, bytes: &[u8]| {
        script.push(0x62 + bytes.len() as u8);
        script.extend(bytes);
    };
    if !first.is_empty() {
        say(&mut script, first);
    }
    for _ in 0..noise.next() % 40 {
        if noise.next() < 60 {
            script.push(noise.next());
        }
        message.chunks(usize::from(noise.next() % 120) + 1).for_each(|chunk| say(&mut script, chunk));
        script.push(0x50);
    }
    for _ in 0..noise.next() % 8 {
        let at = HEAD + noise.below(script.len() - HEAD + 1);
        if at < script.len() {
            script[at] = noise.next();
        }
    }
    script
}

#[test]
fn the_corpus_leads_to_samples() {
    for (target, body) in [
        ("flock", fuzzing::flock as Body),
        ("xbus", fuzzing::xbus),
        ("x_imu3", fuzzing::x_imu3),
        ("fastrak", fuzzing::fastrak),
        ("motionstar", fuzzing::motionstar),
        ("open_imu", fuzzing::open_imu),
        ("polhemus", fuzzing::polhemus),
        ("slimevr", fuzzing::slimevr),
        ("vrpn", fuzzing::vrpn),
        ("witmotion", fuzzing::witmotion),
    ] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus").join(target);
        let files = std::fs::read_dir(folder).unwrap().flatten();
        let published: Vec<_> =
            files.map(|file| (file.file_name(), body(&std::fs::read(file.path()).unwrap()))).collect();
        assert!(
            published.iter().any(|(_, samples)| *samples > 0),
            "{target}: no seed leads to a sample: {published:?}"
        );
    }
}

#[test]
fn drivers_bear_anything() {
    let mut noise = Noise::new(7);
    let mut published = [0; 10];
    for _ in 0..400 {
        let items = crate::matrix::xbus_items();
        let chain = crate::matrix::xbus_chain();
        published[0] += fuzzing::xbus(&input(&mut noise, Some((3, 2)), &[], &items));
        published[1] += fuzzing::xbus(&input(&mut noise, Some((3, 1)), &[], &chain));
        published[2] +=
            fuzzing::x_imu3(&input(&mut noise, Some((2, 1)), &[], &crate::matrix::x_imu3_binary()));
        published[3] +=
            fuzzing::fastrak(&input(&mut noise, Some((5, 1)), &[], &crate::matrix::fastrak_binary()));
        published[4] +=
            fuzzing::motionstar(&input(&mut noise, Some((6, 1)), &[], &crate::matrix::motionstar()));
        let peer = SocketAddr::from(([192, 0, 2, 1], 6969));
        let mut chunk =
            Datagram { peer, data: &slime::encode(0, 3, &slime::handshake_body([1; 6], 22, "x")) }.encode();
        let body = slime::motion_body(0, [1.0, 0.0, 0.0, 0.0], [0.0; 3]);
        Datagram { peer, data: &slime::encode(1, 23, &body) }.encode_into(&mut chunk);
        published[5] += fuzzing::slimevr(&input(&mut noise, None, &chunk, &chunk));
        published[7] += fuzzing::open_imu(&input(&mut noise, None, &[], &crate::matrix::open_imu_line()));
        published[6] += fuzzing::vrpn(&input(&mut noise, Some((0, 1)), &[], &crate::matrix::vrpn()));
        published[8] +=
            fuzzing::polhemus(&input(&mut noise, Some((5, 1)), &[], &crate::matrix::polhemus_binary()));
        published[9] +=
            fuzzing::witmotion(&input(&mut noise, Some((1, 1)), &[], &crate::matrix::witmotion()));
        let report = crate::matrix::slimevr_report();
        published[9] += fuzzing::slimevr(&input(&mut noise, None, &report, &report));
        // The messages of one device at the driver of another, and noise.
        let foreign = [noise.bytes(40), items, chain, crate::matrix::x_imu3_binary()].concat();
        let foreign = input(&mut noise, None, &[0xFA, 0xFF, 0x32, 0xFF, 0x01], &foreign);
        for body in [
            fuzzing::flock as Body,
            fuzzing::fastrak,
            fuzzing::motionstar,
            fuzzing::polhemus,
            fuzzing::slimevr,
            fuzzing::vrpn,
            fuzzing::witmotion,
        ] {
            body(&foreign);
        }
    }
    // The scripts do reach the streams.
    assert!(published.iter().all(|&samples| samples > 50), "{published:?}");
}
