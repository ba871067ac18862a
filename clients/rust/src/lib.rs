//! A connection to a stage that lasts: typed messages, requests with their answers, events without gaps.
//!
//! What comes in: an address, choices of topics, requests. What goes out: messages one after the other, answers and refusals. It has no task or thread of its own: it reads and
//! writes while somebody awaits it. It never decides what a message means.
//!
//! ```no_run
//! use posed_client::{Call, Choice, Client, Started, Topic};
//!
//! # async fn record() -> Result<(), posed_client::Error> {
//! let mut stage = Client::connect("127.0.0.1:8787", None).await?;
//! stage.subscribe(Choice::of([Topic::Jobs])).await?;
//! let job: Started = stage.request(&Call::RecordStart { name: None }).await?;
//! println!("job {} of {}", job.job, stage.hello().stage);
//! println!("{:?}", stage.next().await?);
//! # Ok(())
//! # }
//! ```

mod address;
mod error;
mod socket;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::pin::Pin;
use std::time::Duration;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

pub use self::error::Error;
use self::socket::{Broken, Socket};
pub use posed_protocol::{
    Call, DropPolicy, Feed, Field, Hello, Job, JobState, Jobs, ServerMessage, Started, Topic,
};

/// Waits before the first, second, ... attempt to connect again; the last one from then on.
const RETRY: [Duration; 4] =
    [Duration::from_millis(500), Duration::from_secs(1), Duration::from_secs(2), Duration::from_secs(5)];
/// The same where the stage has changed: the next one waits already.
const STAGE_CHANGED_RETRY: Duration = Duration::from_millis(50);

/// What is subscribed to, and how.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Choice {
    /// Which topics; those that the stage lacks are left out.
    pub topics: Vec<Topic>,
    /// At most so many messages per second and topic, events excepted; `None`: every frame.
    pub max_rate_hz: Option<f64>,
    /// Only these sensors, by name; `None`: all.
    pub sensors: Option<Vec<String>>,
    /// What is said of each sensor; `None`: device, position, orientation and their expected error.
    pub fields: Option<Vec<Field>>,
    /// What to do when this client is too slow; `None`: the newest states count.
    pub drop: Option<DropPolicy>,
}

impl Choice {
    /// These topics, as they come.
    pub fn of(topics: impl Into<Vec<Topic>>) -> Self {
        Self { topics: topics.into(), ..Self::default() }
    }
}

/// A connection that is being made, whoever awaits it.
type Connecting = Pin<Box<dyn Future<Output = Result<(Socket, Hello), Error>> + Send>>;

/// A connection.
pub struct Client {
    url: String,
    token: Option<String>,
    reconnects: bool,
    hello: Hello,
    socket: Option<Socket>,
    /// The next one.
    connecting: Option<Connecting>,
    choices: Vec<Choice>,
    next_id: i64,
    /// Requests that are still to be sent on this connection.
    unsent: VecDeque<String>,
    /// Messages that came while an answer was waited for.
    came: VecDeque<ServerMessage>,
    /// The newest event that came, or was there before.
    last_event: u64,
    catching_up: Option<CatchingUp>,
}

/// Events, until those that were missed are all here: they come in another order.
#[derive(Debug)]
struct CatchingUp {
    /// The request behind whose answer all of them are here.
    until: i64,
    events: Vec<(u64, Value)>,
}

/// One message of the daemon.
enum Received {
    Message(Box<ServerMessage>),
    Answer {
        id: Option<i64>,
        result: Result<Value, Error>,
    },
    /// Nothing for anybody.
    Nothing,
}

impl Client {
    /// Connects to HOST:PORT, to the address of a page, of a hub's stage or of a take (`http://HOST:8787/takes/NAME/`), or to that of a websocket, and returns once the daemon has said who it is.
    ///
    /// # Errors
    /// [`Error::Address`], [`Error::Token`], [`Error::Unauthorised`], [`Error::Unreachable`].
    pub async fn connect(address: &str, token: Option<&str>) -> Result<Self, Error> {
        let url = address::websocket_of(address)?;
        let token = token.map(str::to_owned);
        let (socket, hello) = Socket::open(&url, token.as_deref()).await?;
        Ok(Self {
            url,
            token,
            reconnects: true,
            last_event: hello.last_event_id,
            hello,
            socket: Some(socket),
            connecting: None,
            choices: Vec::new(),
            next_id: 1,
            unsent: VecDeque::new(),
            came: VecDeque::new(),
            catching_up: None,
        })
    }

    /// Ends with the connection instead of connecting again.
    #[must_use]
    pub fn without_reconnection(self) -> Self {
        Self { reconnects: false, ..self }
    }

    /// Who speaks, and what there is: of the newest connection.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Subscribes, now and after every reconnection, in the place of what was chosen for these topics before.
    ///
    /// # Errors
    /// [`Error::Refused`], such as for a sensor that the stage does not have; [`Error::Lost`] where the connection broke before the answer: it holds on the next one.
    pub async fn subscribe(&mut self, choice: Choice) -> Result<(), Error> {
        for other in &mut self.choices {
            other.topics.retain(|topic| !choice.topics.contains(topic));
        }
        self.choices.retain(|other| !other.topics.is_empty());
        self.choices.push(choice.clone());
        match self.subscription(&choice) {
            Some(feed) => self.ask(&feed).await.map(drop),
            None => Ok(()),
        }
    }

    /// Asks the daemon, and waits for its answer: `()` where it only says that it was done.
    ///
    /// # Errors
    /// [`Error::Refused`]; [`Error::Lost`] where the connection broke before the answer; [`Error::Answer`] where it is another one than `T`.
    pub async fn request<T: DeserializeOwned>(&mut self, call: &Call) -> Result<T, Error> {
        let result = self.ask(call).await?;
        serde_json::from_value(result).map_err(Error::Answer)
    }

    /// The next message of what was subscribed to. May be dropped before it has come, and called again.
    ///
    /// # Errors
    /// [`Error::Unauthorised`]; without reconnection [`Error::Lost`], too. Then nothing more comes.
    pub async fn next(&mut self) -> Result<ServerMessage, Error> {
        loop {
            if let Some(message) = self.came.pop_front() {
                return Ok(message);
            }
            if self.socket.is_none() {
                self.connect_again().await?;
            }
            match self.receive().await {
                Ok(Received::Message(message)) => return Ok(*message),
                Ok(_) => {}
                Err(broken) if self.reconnects => self.lose(&broken),
                Err(broken) => return Err(Error::Lost(broken.why)),
            }
        }
    }

    /// Ends the connection in order.
    pub async fn close(mut self) {
        if let Some(socket) = self.socket.take() {
            socket.close().await;
        }
    }

    async fn ask(&mut self, request: &impl Serialize) -> Result<Value, Error> {
        if self.socket.is_none() {
            return Err(Error::Lost("the connection is lost".to_owned()));
        }
        let asked = self.put(request)?;
        loop {
            match self.receive().await {
                Ok(Received::Answer { id, result }) if id == Some(asked) => return result,
                Ok(Received::Message(message)) => self.came.push_back(*message),
                Ok(_) => {}
                Err(broken) => {
                    self.lose(&broken);
                    return Err(Error::Lost(broken.why));
                }
            }
        }
    }

    /// Puts a request among those to be sent; its number.
    fn put(&mut self, request: &impl Serialize) -> Result<i64, Error> {
        let id = self.next_id;
        self.next_id += 1;
        let mut request = serde_json::to_value(request).map_err(Error::Request)?;
        request["id"] = json!(id);
        self.unsent.push_back(request.to_string());
        Ok(id)
    }

    /// Sends what is to be sent, and takes in one message.
    async fn receive(&mut self) -> Result<Received, Broken> {
        let Some(socket) = &mut self.socket else { return Err(Broken::of("the connection is lost")) };
        while let Some(text) = self.unsent.front() {
            // Sent twice where this is dropped in between: subscriptions mind it not, and who drops a request does not want its answer.
            socket.send(text).await?;
            self.unsent.pop_front();
        }
        let message = socket.receive().await?;
        self.take(message)
    }

    fn take(&mut self, message: Value) -> Result<Received, Broken> {
        match message["type"].as_str() {
            Some("ok" | "error") => return Ok(self.answer(&message)),
            Some("hello") => return Ok(Received::Nothing),
            _ => {}
        }
        if let Some(id) = message["event_id"].as_u64() {
            if let Some(catching_up) = &mut self.catching_up {
                catching_up.events.push((id, message));
                return Ok(Received::Nothing);
            }
            if id <= self.last_event {
                return Ok(Received::Nothing);
            }
            self.last_event = id;
        }
        typed(message).map(|message| Received::Message(Box::new(message)))
    }

    fn answer(&mut self, message: &Value) -> Received {
        let id = message["id"].as_i64();
        if let Some(CatchingUp { mut events, .. }) = self.catching_up.take_if(|until| id == Some(until.until))
        {
            events.sort_by_key(|(id, _)| *id);
            for (id, event) in events {
                if id > self.last_event {
                    self.last_event = id;
                    // One of a later version than this client's is no reason to lose the others.
                    self.came.extend(typed(event).ok());
                }
            }
            return Received::Nothing;
        }
        let text = |key: &str| message[key].as_str().unwrap_or_default().to_owned();
        let result = match message["type"].as_str() {
            Some("ok") => Ok(message["result"].clone()),
            _ => Err(Error::Refused { code: text("code"), message: text("message") }),
        };
        Received::Answer { id, result }
    }

    /// The request that subscribes to what there is of it.
    fn subscription(&self, choice: &Choice) -> Option<Feed> {
        let Choice { topics, max_rate_hz, sensors, fields, drop } = choice.clone();
        let topics: Vec<Topic> =
            topics.into_iter().filter(|topic| self.hello.topics.contains(topic)).collect();
        let feed = |topics| Feed::Subscribe { topics, max_rate_hz, sensors, fields, drop };
        (!topics.is_empty()).then(|| feed(topics))
    }

    fn lose(&mut self, broken: &Broken) {
        self.socket = None;
        self.unsent.clear();
        self.catching_up = None;
        if self.reconnects {
            let wait = if broken.stage_changed { STAGE_CHANGED_RETRY } else { RETRY[0] };
            self.connecting = Some(Box::pin(connected(self.url.clone(), self.token.clone(), wait)));
        }
    }

    /// Connects as soon as somebody answers, and goes on where it was.
    async fn connect_again(&mut self) -> Result<(), Error> {
        let Some(connecting) = &mut self.connecting else {
            return Err(Error::Lost("the connection is lost".to_owned()));
        };
        let connected = connecting.as_mut().await;
        self.connecting = None;
        let (socket, hello) = connected?;
        self.socket = Some(socket);
        let is_another = hello.epoch_utc != self.hello.epoch_utc || hello.last_event_id < self.last_event;
        self.hello = hello;
        if is_another {
            // A daemon that was started anew counts from one again.
            self.last_event = 0;
        }
        for choice in self.choices.clone() {
            if let Some(feed) = self.subscription(&choice) {
                self.put(&feed)?;
            }
        }
        self.put(&Feed::Resume { after: self.last_event })?;
        // Answers and events come in one order: when this one is answered, all that were asked for are here.
        let until = self.put(&Feed::Unsubscribe { topics: Vec::new() })?;
        self.catching_up = Some(CatchingUp { until, events: Vec::new() });
        Ok(())
    }
}

/// The next connection, as soon as somebody answers.
async fn connected(url: String, token: Option<String>, first: Duration) -> Result<(Socket, Hello), Error> {
    let mut wait = first;
    let mut later = RETRY[1..].iter();
    loop {
        #[expect(clippy::disallowed_methods, reason = "who is not there is not asked again at once")]
        tokio::time::sleep(wait).await;
        match Socket::open(&url, token.as_deref()).await {
            Err(Error::Unreachable { .. }) => wait = *later.next().unwrap_or(&RETRY[RETRY.len() - 1]),
            answered => return answered,
        }
    }
}

fn typed(message: Value) -> Result<ServerMessage, Broken> {
    serde_json::from_value(message)
        .map_err(|error| Broken::of(&format!("a message is none that this client knows: {error}")))
}
