//! Avatars by VMC, programs that read MVN's stream, laboratories by LSL: that they are reported, and what is said where that cannot be.

use posed_daemon::StageClock;
use posed_drivers::Timestamp;
use posed_fusion::body::{ANGLES, BodySegment, Heading, SEGMENTS};
use posed_protocol::Status;
use posed_stage::output::{Body, Output, PositionSource, SegmentEstimate, SegmentState};
use rosc::{OscPacket, OscType, decoder};
use tokio::net::UdpSocket;
use tokio::time::timeout;

use super::harness::{PATIENCE, config, stage, start};

/// Lying, all segments at one place.
fn body(t_ms: i64) -> Body {
    let segment = SegmentEstimate {
        state: SegmentState::Ok,
        fault: None,
        sensor: None,
        position_m: Some([1.0, 2.0, 3.0]),
        orientation_wxyz: Some([1.0, 0.0, 0.0, 0.0]),
        sigma_rad: 0.01,
        learnt: None,
    };
    let t_valid = Timestamp::from_nanos(t_ms * 1_000_000);
    let (heading, position_source) = (Heading::Field, PositionSource::Trackers);
    Body {
        index: 0,
        t_valid,
        heading,
        heading_sigma_rad: Some(0.02),
        position_source,
        position_sigma_m: Some(0.02),
        contacts: None,
        segments: vec![segment; SEGMENTS],
        angles_rad: [None; ANGLES],
        spread: Default::default(),
    }
}

/// Address and arguments of each message of a datagram.
async fn received(socket: &UdpSocket) -> Vec<(String, Vec<OscType>)> {
    let mut datagram = [0; 2000];
    let length = timeout(PATIENCE, socket.recv(&mut datagram)).await.expect("a datagram").unwrap();
    let (_, packet) = decoder::decode_udp(&datagram[..length]).unwrap();
    let OscPacket::Bundle(bundle) = packet else { panic!("{packet:?}") };
    let message = |packet| match packet {
        OscPacket::Message(message) => (message.addr, message.args),
        OscPacket::Bundle(bundle) => panic!("{bundle:?}"),
    };
    bundle.content.into_iter().map(message).collect()
}

#[tokio::test]
async fn avatars_get_bones_and_a_word_when_there_are_none() {
    let sockets =
        [UdpSocket::bind("127.0.0.1:0").await.unwrap(), UdpSocket::bind("127.0.0.1:0").await.unwrap()];
    let [one, two] = [0, 1].map(|at: usize| sockets[at].local_addr().unwrap());
    let stage = stage(&format!("[vmc]\ntargets = [\"{one}\", \"{two}\"]\n[body]\nheight_m = 1.8"));
    let server = start(&stage, config());
    server.hub.publish(&Output::Body(&body(1000)));
    for socket in &sockets {
        let messages = received(socket).await;
        assert_eq!(messages[0], ("/VMC/Ext/OK".to_owned(), vec![OscType::Int(1)]));
        let (address, hips) = &messages[3];
        assert_eq!((address.as_str(), &hips[0]), ("/VMC/Ext/Bone/Pos", &OscType::String("Hips".to_owned())));
        assert_eq!(hips[1..4], [1.0, 3.0, 2.0].map(OscType::Float), "Unity's axes");
        // Head, hands, feet and shoulders wear nothing.
        assert_eq!(messages.len(), 3 + SEGMENTS - BodySegment::LEAVES.len());
    }
    // The same instant again is none of sixty a second; then nothing comes any more.
    server.hub.publish(&Output::Body(&body(1001)));
    server.hub.publish_status(Status { t_s: 9.0, ..Status::default() });
    let messages = received(&sockets[0]).await;
    assert_eq!(messages[0], ("/VMC/Ext/OK".to_owned(), vec![OscType::Int(0)]));
    assert_eq!(messages[1], ("/VMC/Ext/T".to_owned(), vec![OscType::Float(9.0)]));
}

#[tokio::test]
async fn programs_get_the_body_as_mvn_sends_it() {
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let stage =
        stage(&format!("[mvn]\ntargets = [\"{}\"]\n[body]\nheight_m = 1.8", socket.local_addr().unwrap()));
    let server = start(&stage, config());
    server.hub.publish(&Output::Body(&body(1000)));
    for kind in ["12", "13", "02", "20", "25"] {
        let mut datagram = [0; 2000];
        let length = timeout(PATIENCE, socket.recv(&mut datagram)).await.expect("a datagram").unwrap();
        assert_eq!(datagram[..6], *format!("MXTP{kind}").as_bytes());
        assert_eq!(length, 24 + usize::from(u16::from_be_bytes([datagram[22], datagram[23]])));
    }
}

#[tokio::test]
async fn a_target_without_an_address_is_named() {
    for table in ["vmc", "mvn"] {
        let stage = stage(&format!("[{table}]\ntargets = [\"no-such-host.invalid:39539\"]"));
        let error = posed_daemon::server::Server::bind(&stage, config()).err().unwrap().to_string();
        assert!(
            error.contains("no-such-host.invalid") && error.contains(&format!("{table}.targets")),
            "{error}"
        );
    }
}

#[tokio::test]
async fn a_stage_runs_without_liblsl_and_says_so() {
    let mut config = config();
    config.clock = Some(StageClock::start());
    let server = start(&stage("[lsl]\nlibrary = \"/no/such/liblsl.so\""), config);
    let mut client = server.client().await;
    client.subscribe(&["status", "sensors"]).await;
    server.hub.publish_status(Status { t_s: 1.0, ..Status::default() });
    let problems = client.next().await["problems"].clone();
    assert_eq!(problems[0]["code"], "lsl");
    assert!(problems[0]["message"].as_str().unwrap().contains("/no/such/liblsl.so"), "{problems}");
    server.frame(2);
    assert_eq!(client.next().await["type"], "sensors");
}
