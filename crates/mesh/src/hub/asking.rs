//! What a hub asks a stage for: frames come only while somebody at the hub looks.
//!
//! In: what clients here want. Out: a token that says so, which the stage sees, and a subscriber for what it then sends.

use tokio::sync::mpsc;
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;

use crate::wire::Keys;
use posed_protocol::Wish;

/// The wish as it stands.
pub(super) struct Asking {
    session: Session,
    keys: Keys,
    fed: mpsc::Sender<Vec<u8>>,
    wish: Wish,
    /// Both gone where nothing is wanted.
    token: Option<LivelinessToken>,
    frames: Option<Subscriber<()>>,
}

impl Asking {
    /// For nothing yet; frames that come go into `fed`.
    pub(super) fn new(session: Session, keys: Keys, fed: mpsc::Sender<Vec<u8>>) -> Self {
        Self { session, keys, fed, wish: Wish::default(), token: None, frames: None }
    }

    /// Asks for this from now on.
    pub(super) async fn ask(&mut self, wish: &Wish) -> zenoh::Result<()> {
        if *wish == self.wish {
            return Ok(());
        }
        if wish.is_empty() {
            (self.token, self.frames) = (None, None);
        } else {
            if self.frames.is_none() {
                self.frames = Some(subscribe(&self.session, self.keys.frames(), self.fed.clone()).await?);
            }
            let hub = self.session.zid().to_string();
            // In the place of an older one, after it: the stage never sees nothing wanted in between.
            self.token = Some(self.session.liveliness().declare_token(self.keys.wish(&hub, wish)).await?);
        }
        self.wish = wish.clone();
        Ok(())
    }
}

/// What comes under a key, for a task; more than it has room for is lost.
pub(super) async fn subscribe(
    session: &Session,
    key: String,
    to: mpsc::Sender<Vec<u8>>,
) -> zenoh::Result<Subscriber<()>> {
    let take = move |sample: zenoh::sample::Sample| _ = to.try_send(sample.payload().to_bytes().into_owned());
    session.declare_subscriber(key).callback(take).await
}
