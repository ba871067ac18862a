//! What can go wrong.

/// Why something was not done.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The daemon refused a request: a code for programs, a sentence for people.
    #[error("{message}")]
    Refused {
        /// `bad_request`, `forbidden`, `busy`, ...
        code: String,
        /// What was wrong, and what would be right.
        message: String,
    },
    /// Nobody who speaks this protocol answers.
    #[error("no daemon can be spoken to at {address}: {reason}")]
    Unreachable {
        /// Of the websocket.
        address: String,
        /// What was seen instead.
        reason: String,
    },
    /// The daemon wants a token, or does not take this one.
    #[error("{address}: this daemon wants a token, or does not take this one")]
    Unauthorised {
        /// Of the websocket.
        address: String,
    },
    /// The connection broke.
    #[error("the daemon has gone away: {0}")]
    Lost(String),
    /// No address of a daemon.
    #[error("{0:?} is no address of a daemon: give HOST:PORT, or ws://HOST:PORT/ws")]
    Address(String),
    /// No token.
    #[error("a secret has visible characters only")]
    Token,
    /// A request cannot be written.
    #[error("the request cannot be written: {0}")]
    Request(serde_json::Error),
    /// The answer is not what was expected.
    #[error("the answer is another one than was expected: {0}")]
    Answer(serde_json::Error),
}
