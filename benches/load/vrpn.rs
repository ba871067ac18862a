//! VRPN clients, good and bad, that connect by TCP.

use posed_drivers::vrpn::wire::{GREETING, Messages};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use super::clients::Received;

/// Number of the type of poses: the first that the server describes.
const POSE: i32 = 0;

/// A greeted connection.
pub(crate) async fn connect(address: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).await.expect("a connection");
    stream.set_nodelay(true).expect("a socket");
    stream.write_all(&GREETING).await.expect("a connection");
    let mut greeting = [0; GREETING.len()];
    stream.read_exact(&mut greeting).await.expect("a greeting");
    stream
}

/// Takes the time of every frame: when the pose of the last sensor has come.
pub(crate) async fn listen(mut stream: TcpStream, last: i32, seconds: f64) -> Received {
    let mut seen = Received::new(seconds);
    let (mut messages, mut bytes, mut taken) = (Messages::default(), vec![0; 65536], 0);
    loop {
        let read = stream.read(&mut bytes).await.expect("a connection");
        assert!(read > 0, "the server ended it");
        taken += read;
        messages.push(&bytes[..read]);
        while let Some(message) = messages.find().expect("messages") {
            if (message.sender, message.kind) != (last, POSE) {
                continue;
            }
            if seen.frame(message.utc_us as f64 * 1e-6, std::mem::take(&mut taken)) {
                return seen;
            }
        }
    }
}

/// Says the greeting and never reads.
pub(crate) async fn stall(address: &str) {
    let _stream = connect(address).await;
    std::future::pending::<()>().await;
}

/// Sends messages that nobody wants, as fast as they are taken.
pub(crate) async fn flood(address: &str) {
    let mut stream = connect(address).await;
    let mut message = vec![0; 24];
    message[3] = 24;
    while stream.write_all(&message).await.is_ok() {}
}
