//! The fuzz targets' bodies over seeded bytes: noise, and noise sown into messages.

use std::net::SocketAddr;
use std::path::Path;

use posed_drivers::datagram::Datagram;
use posed_drivers::fuzzing;
use posed_drivers::slimevr::wire as slime;

use crate::matrix::Noise;

/// Scripts of a session: its messages in chunks, with time between, and some bytes replaced by noise.
fn scripts(noise: &mut Noise, message: &[u8]) -> Vec<u8> {
    let mut script = vec![noise.next()];
    for _ in 0..noise.next() % 40 {
        if noise.next() < 60 {
            script.push(noise.next());
        }
        for chunk in message.chunks(usize::from(noise.next() % 120) + 1) {
            script.push(0x62 + chunk.len() as u8);
            script.extend(chunk);
        }
        script.push(0x50);
    }
    for _ in 0..noise.next() % 8 {
        let at = noise.below(script.len());
        script[at] = noise.next();
    }
    script
}

#[test]
fn the_corpus_runs_clean() {
    type Body = fn(&[u8]) -> usize;
    fn wire(body: fn(&[u8])) -> impl Fn(&[u8]) -> usize {
        move |data| {
            body(data);
            1
        }
    }
    let run = |target: &str, body: &dyn Fn(&[u8]) -> usize| {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus").join(target);
        let files: Vec<_> = std::fs::read_dir(folder).unwrap().flatten().collect();
        assert!(!files.is_empty(), "{target}");
        let published: Vec<usize> =
            files.iter().map(|file| body(&std::fs::read(file.path()).unwrap())).collect();
        assert!(published.iter().any(|&samples| samples > 0), "{target}: no seed leads to a sample");
    };
    for (target, body) in [
        ("xbus_session", fuzzing::xbus_session as Body),
        ("x_imu3_session", fuzzing::x_imu3_session),
        ("fastrak_session", fuzzing::fastrak_session),
        ("motionstar_session", fuzzing::motionstar_session),
        ("slimevr_session", fuzzing::slimevr_session),
    ] {
        run(target, &body);
    }
    for (target, body) in [
        ("xbus_wire", fuzzing::xbus_wire as fn(&[u8])),
        ("x_imu3_wire", fuzzing::x_imu3_wire),
        ("fastrak_wire", fuzzing::fastrak_wire),
        ("motionstar_wire", fuzzing::motionstar_wire),
        ("slimevr_wire", fuzzing::slimevr_wire),
    ] {
        run(target, &wire(body));
    }
}

#[test]
fn sessions_bear_anything() {
    let mut noise = Noise::new(7);
    let mut published = [0; 5];
    for _ in 0..400 {
        let items = crate::matrix::xbus_items();
        let chain = crate::matrix::xbus_chain();
        published[0] += fuzzing::xbus_session(&scripts(&mut noise, &items));
        published[0] += fuzzing::xbus_session(&scripts(&mut noise, &chain));
        published[1] += fuzzing::x_imu3_session(&scripts(&mut noise, &crate::matrix::x_imu3_binary()));
        published[2] += fuzzing::fastrak_session(&scripts(&mut noise, &crate::matrix::fastrak_binary()));
        published[3] += fuzzing::motionstar_session(&scripts(&mut noise, &crate::matrix::motionstar()));
        let peer = SocketAddr::from(([192, 0, 2, 1], 6969));
        let mut chunk =
            Datagram { peer, data: &slime::encode(0, 3, &slime::handshake_body([1; 6], 22, "x")) }.encode();
        let body = slime::motion_body(0, [1.0, 0.0, 0.0, 0.0], [0.0; 3]);
        Datagram { peer, data: &slime::encode(1, 23, &body) }.encode_into(&mut chunk);
        let mut script = vec![0x62 + chunk.len() as u8];
        script.extend(&chunk);
        script.extend(scripts(&mut noise, &chunk));
        published[4] += fuzzing::slimevr_session(&script);
    }
    // The scripts do reach the streams.
    assert!(published.iter().all(|&samples| samples > 50), "{published:?}");
}

#[test]
fn wires_bear_anything() {
    let mut noise = Noise::new(8);
    for _ in 0..300 {
        let mut bytes = vec![noise.next()];
        for _ in 0..noise.next() % 12 {
            match noise.next() % 8 {
                0 => bytes.extend(noise.bytes(40)),
                1 => bytes.extend(crate::matrix::xbus_items()),
                2 => bytes.extend(crate::matrix::xbus_chain()),
                3 => bytes.extend(crate::matrix::x_imu3_binary()),
                4 => bytes.extend(crate::matrix::fastrak_binary()),
                5 => bytes.extend(crate::matrix::motionstar()),
                6 => bytes.extend([0xFA, 0xFF, 0x32, 0xFF, 0x01]),
                _ => {
                    let at = noise.below(bytes.len());
                    bytes[at] = noise.next();
                }
            }
        }
        fuzzing::xbus_wire(&bytes);
        fuzzing::x_imu3_wire(&bytes);
        fuzzing::fastrak_wire(&bytes);
        fuzzing::motionstar_wire(&bytes);
        fuzzing::slimevr_wire(&bytes);
    }
}
