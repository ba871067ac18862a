//! Programs that speak VRPN: both ways of arriving, what they received, and what a bad one does to the others.

use std::net::SocketAddr;

use posed_drivers::vrpn::wire::{self, From, Messages, system};
use posed_drivers::vrpn::{Settings, VrpnSession};
use posed_drivers::{LineEvent, Measurement, Output, Sample, Session, State, Timestamp};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::time::timeout;

use super::harness::{PATIENCE, Running, config, estimate, stage, start};

fn server() -> Running {
    start(&stage("[vrpn]\nlisten = \"127.0.0.1:0\""), config())
}

/// Reads greetings and messages like the C++ client does.
struct Client {
    stream: TcpStream,
    messages: Messages,
}

impl Client {
    async fn connect(address: SocketAddr) -> Self {
        Self::greeted(TcpStream::connect(address).await.unwrap()).await
    }

    async fn greeted(mut stream: TcpStream) -> Self {
        stream.write_all(&wire::GREETING).await.unwrap();
        let mut greeting = [0; 24];
        timeout(PATIENCE, stream.read_exact(&mut greeting)).await.unwrap().unwrap();
        wire::check_greeting(&greeting).unwrap();
        Self { stream, messages: Messages::default() }
    }

    /// Number of the sender, type, payload; `None` at the end of the connection.
    async fn next(&mut self) -> Option<(i32, i32, Vec<u8>)> {
        loop {
            if let Some(message) = self.messages.find().unwrap() {
                return Some((message.sender, message.kind, message.payload.to_vec()));
            }
            let mut bytes = [0; 65536];
            match timeout(PATIENCE, self.stream.read(&mut bytes)).await.unwrap() {
                Ok(read @ 1..) => self.messages.push(&bytes[..read]),
                _ => return None,
            }
        }
    }

    /// The names of senders and types, in their order.
    async fn described(&mut self) -> (Vec<String>, Vec<String>) {
        let (mut senders, mut types) = (Vec::new(), Vec::new());
        while types.len() < 7 {
            let (number, kind, payload) = self.next().await.unwrap();
            let name = String::from_utf8(payload[4..payload.len() - 1].to_vec()).unwrap();
            let list = if kind == system::SENDER { &mut senders } else { &mut types };
            assert_eq!(number as usize, list.len());
            list.push(name);
        }
        (senders, types)
    }
}

/// Publishes until the client has what it waits for: it is among those who receive frames only after its greeting. The last frame
/// published, and the message.
async fn reported(server: &Running, client: &mut Client) -> (u64, (i32, i32, Vec<u8>)) {
    for frame in 1.. {
        server.frame(frame);
        if let Ok(message) = timeout(std::time::Duration::from_millis(20), client.next()).await {
            return (frame, message.unwrap());
        }
    }
    unreachable!()
}

/// The eight numbers of a pose's message: a spare word, the position, the quaternion with its scalar last.
fn pose(payload: &[u8]) -> [f64; 7] {
    assert_eq!(payload.len(), 64);
    std::array::from_fn(|k| f64::from_be_bytes(payload[8 * k + 8..8 * k + 16].try_into().unwrap()))
}

/// What the message of a frame's first sensor has to hold.
fn expected(frame: u64) -> [f64; 7] {
    let pose = estimate(frame).sensors[0].pose.unwrap();
    let ([x, y, z], [w, i, j, k]) = (pose.position_m.unwrap(), pose.orientation_wxyz);
    [x, y, z, i, j, k, w]
}

#[tokio::test]
async fn every_sensor_is_a_tracker() {
    let server = server();
    let mut client = Client::connect(server.vrpn.unwrap()).await;
    let (senders, types) = client.described().await;
    assert_eq!(senders, ["left", "right"]);
    assert_eq!(types[..2], ["vrpn_Tracker Pos_Quat", "vrpn_Tracker Velocity"]);
    let (last, (sender, kind, payload)) = reported(&server, &mut client).await;
    assert_eq!((sender, kind), (0, 0), "the right one is missing and says nothing");
    let first = (1..=last).find(|frame| pose(&payload) == expected(*frame));
    let first = first.unwrap_or_else(|| panic!("{:?} is no frame up to {last}", pose(&payload)));
    // From there on every frame comes once, in order: pose, velocity and acceleration.
    (last + 1..=last + 20).for_each(|frame| server.frame(frame));
    assert_eq!(client.next().await.unwrap().1, 1);
    for frame in first + 1..=last + 20 {
        let (sender, kind, payload) = client.next().await.unwrap();
        assert_eq!((sender, kind, pose(&payload)), (0, 0, expected(frame)), "frame {frame}");
        for more in [1, 2] {
            let (sender, kind, _) = client.next().await.unwrap();
            assert_eq!((sender, kind), (0, more), "frame {frame}");
        }
    }
    // It asks for a tracker by its own numbers.
    let mut ask = Vec::new();
    wire::description(system::SENDER, 40, "right", 0, &mut ask);
    wire::description(system::TYPE, 50, "vrpn_Base ping_message", 0, &mut ask);
    wire::message(From { sender: 40, kind: 50, utc_ns: 0 }, &[], &mut ask);
    client.stream.write_all(&ask).await.unwrap();
    let pong = loop {
        let (sender, kind, _) = client.next().await.unwrap();
        if kind > 4 {
            break (sender, types[kind as usize].as_str());
        }
    };
    assert_eq!(pong, (1, "vrpn_Base pong_message"));
    server.fault(10, 1, true);
    let text = loop {
        let (sender, kind, payload) = client.next().await.unwrap();
        if kind == 4 {
            break (sender, payload);
        }
    };
    assert_eq!((text.0, text.1.len()), (1, 1032));
}

#[tokio::test]
async fn a_client_that_asks_is_called_back() {
    let server = server();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    // It names another host; the datagram's own address counts. It asks twice; it is called once.
    for _ in 0..2 {
        let request = format!("192.0.2.1 {port}\0");
        socket.send_to(request.as_bytes(), server.vrpn.unwrap()).await.unwrap();
    }
    let (stream, _) = timeout(PATIENCE, listener.accept()).await.unwrap().unwrap();
    let mut client = Client::greeted(stream).await;
    assert_eq!(client.described().await.0, ["left", "right"]);
    assert_eq!(reported(&server, &mut client).await.1.1, 0);
    assert!(timeout(std::time::Duration::from_millis(50), listener.accept()).await.is_err());
}

/// The first `count` samples that our own driver makes of what our own server says.
async fn read_back(server: &Running, session: &mut VrpnSession, count: usize) -> Vec<Sample> {
    let mut stream = TcpStream::connect(server.vrpn.unwrap()).await.unwrap();
    let mut samples = Vec::new();
    let mut buffer = [0; 4096];
    session.handle_line(Timestamp::ZERO, &LineEvent::Opened { modem_lines: false });
    for frame in 1.. {
        while let Some(output) = session.poll_output() {
            match output {
                Output::Transmit(bytes) => stream.write_all(&bytes).await.unwrap(),
                Output::Sample(sample) => samples.push(sample),
                Output::Warning(text) => panic!("{text}"),
                _ => {}
            }
        }
        if samples.len() >= count {
            break;
        }
        server.frame(frame);
        if let Ok(read) = timeout(std::time::Duration::from_millis(20), stream.read(&mut buffer)).await {
            session.handle_bytes(Timestamp::from_nanos(frame as i64 * 1_000_000), &buffer[..read.unwrap()]);
        }
    }
    samples
}

#[tokio::test]
async fn our_own_driver_reads_what_our_own_server_serves() {
    let server = server();
    let settings = Settings { trackers: vec!["right".into(), "left".into()] };
    let mut session = VrpnSession::new(settings, &[1, 2]).unwrap();
    let mut last = 0;
    for sample in read_back(&server, &mut session, 20).await {
        let Measurement::Pose { position_m, orientation_wxyz: Some(q), .. } = sample.measurement else {
            panic!("{sample:?}")
        };
        let frame = (last + 1..last + 100)
            .find(|frame| estimate(*frame).sensors[0].pose.unwrap().position_m == position_m);
        last = frame.unwrap_or_else(|| panic!("{sample:?} is no frame after {last}"));
        let pose = estimate(last).sensors[0].pose.unwrap();
        assert!(q.iter().zip(pose.orientation_wxyz).all(|(a, b)| (a - b).abs() < 1e-12));
        assert_eq!(sample.address, 2, "the right one is missing and says nothing");
    }
    assert_eq!(*session.state(), State::Streaming);
    assert_eq!((session.counters().rejected, session.counters().bytes_skipped), (0, 0));
}

#[tokio::test]
async fn who_is_no_vrpn_client_or_wants_a_log_is_sent_away() {
    let server = server();
    for bad in [&b"GET / HTTP/1.1\r\nHost: here\r\n\r\n"[..24], b"vrpn: ver. 07.38  2\0\0\0\0\0"] {
        let mut stream = TcpStream::connect(server.vrpn.unwrap()).await.unwrap();
        stream.write_all(bad).await.unwrap();
        let mut rest = Vec::new();
        timeout(PATIENCE, stream.read_to_end(&mut rest)).await.unwrap().unwrap();
        assert_eq!(rest, wire::GREETING);
    }
    let mut client = Client::connect(server.vrpn.unwrap()).await;
    let mut log = Vec::new();
    let names = b"\0\0\0\x01\0\0\0\x01a\0b\0";
    wire::message(From { sender: 1, kind: system::LOG, utc_ns: 0 }, names, &mut log);
    client.stream.write_all(&log).await.unwrap();
    while client.next().await.is_some() {}
}

#[tokio::test]
async fn half_a_greeting_and_a_stalled_client_delay_nobody() {
    let server = server();
    let mut half = TcpStream::connect(server.vrpn.unwrap()).await.unwrap();
    half.write_all(&wire::GREETING[..10]).await.unwrap();
    let _stalled = Client::connect(server.vrpn.unwrap()).await;
    let mut client = Client::connect(server.vrpn.unwrap()).await;
    client.described().await;
    reported(&server, &mut client).await;
    for frame in 1000_u64..1200 {
        server.frame(frame);
        loop {
            let (_, kind, payload) = client.next().await.unwrap();
            let x = f64::from_be_bytes(payload[8..16].try_into().unwrap());
            if kind == 0 && (x - 0.1 - frame as f64 * 1e-3).abs() < 1e-9 {
                break;
            }
        }
    }
    // The half greeting has had its time.
    let mut rest = Vec::new();
    timeout(PATIENCE, half.read_to_end(&mut rest)).await.unwrap().unwrap();
}

#[tokio::test]
async fn a_taken_port_is_named() {
    let taken = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = taken.local_addr().unwrap();
    let stage = stage(&format!("[vrpn]\nlisten = \"{address}\""));
    let error = posed_daemon::server::Server::bind(&stage, config()).err().unwrap().to_string();
    assert!(error.contains("VRPN") && error.contains(&address.to_string()), "{error}");
}

#[tokio::test]
async fn a_client_that_sends_without_end_is_cut_and_another_is_served() {
    let mut stage = stage("[vrpn]\nlisten = \"127.0.0.1:0\"");
    stage.server.limits.byte_burst = 65_536.0;
    let server = start(&stage, config());
    let address = server.vrpn.unwrap();
    let mut flooding = Client::connect(address).await;
    flooding.described().await;
    // Messages of a type that is no system's, with nothing in them.
    let mut message = Vec::new();
    for word in [24_i32, 0, 0, 0, 0, 0] {
        message.extend(word.to_be_bytes());
    }
    let messages = message.repeat(1000);
    timeout(PATIENCE, async { while flooding.stream.write_all(&messages).await.is_ok() {} })
        .await
        .expect("it is never cut");
    let mut other = Client::connect(address).await;
    other.described().await;
    reported(&server, &mut other).await;
}
