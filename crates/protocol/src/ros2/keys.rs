//! Names of ROS 2, and what rmw_zenoh makes of them: keys, liveliness tokens, and what it attaches to each message.

use std::collections::BTreeSet;

use twox_hash::XxHash3_128;

/// Reliable, volatile, the last 10: all else as rmw_zenoh has it by default, which it leaves empty.
const QOS: &str = "::,10:,:,:,,";
/// Enclave of a node without one.
const NO_ENCLAVE: &str = "%";
/// The node's number in its session.
const NODE: usize = 0;

/// A kind of message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    TfMessage,
    PoseStamped,
    Imu,
    JointState,
}

impl Kind {
    /// Its name as DDS has it, and the hash of its definition (REP-2011): the same from Humble to Lyrical.
    fn type_name_and_hash(self) -> (&'static str, &'static str) {
        match self {
            Self::TfMessage => (
                "tf2_msgs::msg::dds_::TFMessage_",
                "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
            ),
            Self::PoseStamped => (
                "geometry_msgs::msg::dds_::PoseStamped_",
                "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
            ),
            Self::Imu => (
                "sensor_msgs::msg::dds_::Imu_",
                "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
            ),
            Self::JointState => (
                "sensor_msgs::msg::dds_::JointState_",
                "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
            ),
        }
    }
}

/// A node with its session.
#[derive(Clone, Debug)]
pub struct Node {
    pub(super) domain_id: u8,
    /// Without a slash at its beginning; empty: none.
    pub(super) namespace: String,
    pub(super) name: String,
}

/// A topic that a node publishes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Fully qualified, without the slash at its beginning.
    pub(super) name: String,
    pub(super) kind: Kind,
}

impl Node {
    /// The liveliness token of the node in the session of this Zenoh id, as zenoh prints that.
    pub fn token(&self, zid: &str) -> String {
        format!("{}/{NODE}/NN/{}", self.session(zid), self.path())
    }

    /// That of the publisher of one of its topics, which is the session's so-manieth, from 0.
    pub fn publisher_token(&self, zid: &str, publisher: usize, topic: &Topic) -> String {
        let (type_name, hash) = topic.kind.type_name_and_hash();
        let id = NODE + 1 + publisher;
        let name = mangled(&topic.name);
        format!("{}/{id}/MP/{}/{name}/{type_name}/{hash}/{QOS}", self.session(zid), self.path())
    }

    fn session(&self, zid: &str) -> String {
        format!("@ros2_lv/{}/{zid}/{NODE}", self.domain_id)
    }

    fn path(&self) -> String {
        format!("{NO_ENCLAVE}/{}/{}", mangled(&self.namespace), self.name)
    }

    /// The key under which messages of a topic are published.
    pub fn key(&self, topic: &Topic) -> String {
        let (type_name, hash) = topic.kind.type_name_and_hash();
        format!("{}/{}/{type_name}/{hash}", self.domain_id, topic.name)
    }
}

/// A name with its slashes, the first of them too, as one part of a key.
fn mangled(name: &str) -> String {
    format!("%{}", name.replace('/', "%"))
}

/// What tells a publisher from all others: of its token.
pub fn gid(token: &str) -> [u8; 16] {
    // The low half first, each little-endian: the whole is.
    XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

/// What goes with each message: its number, from 1, when it was sent, ns since 1970, and who sent it.
pub fn attachment(number: i64, utc_ns: i64, gid: [u8; 16]) -> [u8; 33] {
    let mut bytes = [0; 33];
    bytes[..8].copy_from_slice(&number.to_le_bytes());
    bytes[8..16].copy_from_slice(&utc_ns.to_le_bytes());
    bytes[16] = gid.len() as u8;
    bytes[17..].copy_from_slice(&gid);
    bytes
}

/// Names that ROS 2 takes, each once.
#[derive(Clone, Debug, Default)]
pub(super) struct Names(BTreeSet<String>);

impl Names {
    /// Letters, digits and single `_`, a letter first; numbered where another has that name.
    pub(super) fn of(&mut self, text: &str) -> String {
        let plain = plain(text);
        let mut name = plain.clone();
        let mut number = 2;
        while !self.0.insert(name.clone()) {
            name = format!("{plain}_{number}");
            number += 1;
        }
        name
    }
}

/// Letters, digits and single `_`, a letter first.
pub(super) fn plain(text: &str) -> String {
    let mut name = String::new();
    for c in text.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }) {
        // Names that begin with `_` are hidden.
        if c != '_' || !(name.is_empty() || name.ends_with('_')) {
            name.push(c);
        }
    }
    let name = name.trim_end_matches('_');
    if name.starts_with(|c: char| c.is_ascii_alphabetic()) { name.to_owned() } else { format!("s{name}") }
}
