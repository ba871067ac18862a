//! `posed hub`: the stages of many machines, on one page.

use std::path::PathBuf;

use super::Error;

/// Gives zenoh more threads than it takes by itself, unless somebody has chosen.
///
/// zenoh closes a link that broke with what was not sent still in it, and the system lets the closing thread wait for up to ten seconds (`SO_LINGER`):
/// with zenoh's one thread of a kind, the next link would have to wait too. Threads that nobody needs cost nothing. Must be called before there is a
/// second thread.
#[cfg(feature = "zenoh")]
pub(crate) fn prepare() {
    const VARIABLE: &str = "ZENOH_RUNTIME";
    const THREADS: &str = "(net: (worker_threads: 32), tx: (worker_threads: 32), rx: (worker_threads: 32))";
    if std::env::var_os(VARIABLE).is_none() {
        #[expect(unsafe_code, reason = "zenoh takes it from nowhere else")]
        // SAFETY: the program has one thread yet.
        unsafe {
            std::env::set_var(VARIABLE, THREADS);
        }
    }
}

/// Which stages to join, and where to show them.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  posed hub --listen tcp/0.0.0.0:7447\n  posed hub hub.toml\n  \
    posed hub --connect tcp/10.0.0.7:7447 --http 127.0.0.1:8800 --fuse stage-a\n  \
    posed hub --certificates links --for hub.local,192.168.1.5 --for stage-a\n\n\
    Every stage whose file has [zenoh] connect = [\"tcp/THIS-COMPUTER:7447\"] then shows. Ctrl-C or SIGTERM ends it.")]
pub(crate) struct Args {
    /// A stage file without devices: name, [server] with its tokens, [zenoh].
    #[arg(value_name = "HUB.toml")]
    file: Option<PathBuf>,
    /// Address for stages to connect to, in place of the file's; may be given several times.
    #[arg(long, value_name = "tcp/ADDRESS:PORT")]
    listen: Vec<String>,
    /// Address of a stage or a router to connect to, in place of the file's; may be given several times.
    #[arg(long, value_name = "tcp/HOST:PORT")]
    connect: Vec<String>,
    /// Address for the page and the websocket, in place of the file's; anything but loopback needs a token in the file.
    #[arg(long, value_name = "HOST:PORT")]
    http: Option<String>,
    /// Fuse this stage here, from its input log, by its name on the page; may be given several times.
    #[arg(long, value_name = "STAGE")]
    fuse: Vec<String>,
    /// Makes certificates for encrypted links in this folder and ends: an authority, if the folder has none, and one for each computer.
    #[arg(long, value_name = "FOLDER", requires = "computers")]
    certificates: Option<PathBuf>,
    /// A computer to make a certificate for: the names and addresses by which others connect to it, with commas between; may be given
    /// several times.
    #[arg(long = "for", id = "computers", value_name = "NAME,ADDRESS", requires = "certificates")]
    computers: Vec<String>,
}

#[cfg(not(feature = "zenoh"))]
pub(crate) fn run(args: Args) -> Result<(), Error> {
    let Args { file: _, listen: _, connect: _, http: _, fuse: _, certificates: _, computers: _ } = args;
    Err(Error::Failed(
        "this posed was built without zenoh; install the packaged one, or build it with `--features zenoh`"
            .to_owned(),
    ))
}

#[cfg(feature = "zenoh")]
pub(crate) fn run(args: Args) -> Result<(), Error> {
    use std::path::Path;

    use posed_mesh::{Hub, HubOptions};
    use posed_stage::Stage;

    let Args { file, listen, connect, http, fuse, certificates, computers } = args;
    if let Some(folder) = certificates {
        return make_certificates(&folder, &computers);
    }
    // Checked as the keys of a file are.
    let mut flags = toml::toml! {
        name = "hub"
        [zenoh]
        listen = (listen.clone())
        connect = (connect.clone())
    };
    let given = !listen.is_empty() || !connect.is_empty();
    let (mut stage, folder) = match &file {
        Some(path) => {
            let folder = path.parent().unwrap_or(Path::new("")).to_owned();
            (Stage::load(path).map_err(Error::failed)?, folder)
        }
        None => (Stage::parse("name = \"hub\"").map_err(Error::failed)?, PathBuf::new()),
    };
    if given {
        let tls = stage.zenoh.as_ref().and_then(|zenoh| zenoh.tls.as_ref());
        if let (Some(tls), Some(zenoh)) = (tls, flags["zenoh"].as_table_mut()) {
            zenoh.insert("tls".to_owned(), toml::Value::try_from(tls).map_err(Error::failed)?);
        }
        let checked =
            Stage::parse(&flags.to_string()).map_err(|problems| Error::Usage(problems.to_string()))?;
        let zenoh = stage.zenoh.get_or_insert_default();
        if let Some(flags) = checked.zenoh {
            (zenoh.listen, zenoh.connect) = (flags.listen, flags.connect);
        }
    }
    if stage.zenoh.is_none() {
        return Err(Error::Usage(
            "nobody can be reached: give --listen tcp/0.0.0.0:7447, --connect tcp/HOST:PORT, or a file with [zenoh]".to_owned(),
        ));
    }
    super::run::block_on(async {
        let hub = Hub::start(HubOptions { stage, folder, http, fuse }).map_err(Error::failed)?;
        let ended =
            super::watch::until_end_with(hub.url(), hub.stages(), hub.part_ended(), None, in_words).await;
        hub.shutdown().await;
        ended
    })
}

/// Certificates for encrypted links, and what to do with them.
#[cfg(feature = "zenoh")]
fn make_certificates(folder: &std::path::Path, computers: &[String]) -> Result<(), Error> {
    use std::fmt::Write as _;

    let written = posed_mesh::write_certificates(folder, computers).map_err(Error::failed)?;
    let mut text = String::new();
    for path in &written {
        let _ = writeln!(text, "wrote {}", path.display());
    }
    if written.is_empty() {
        let _ = writeln!(text, "nothing to do: all of these have certificates in {}", folder.display());
    }
    let _ = writeln!(
        text,
        "Copy {}, NAME.pem and NAME-key.pem to each computer, and name them in [zenoh.tls] there; authority-key.pem stays here.",
        posed_mesh::AUTHORITY
    );
    super::print(&text)
}

/// All stages in one line.
#[cfg(feature = "zenoh")]
fn in_words(stages: &posed_protocol::Stages) -> String {
    use posed_protocol::StagePresence;

    let stage = |entry: &posed_protocol::StageEntry| match entry.state {
        StagePresence::Joining => format!("{} joining", entry.id),
        StagePresence::Present => format!("{} {:.0} Hz", entry.id, entry.frames_hz),
        StagePresence::Gone => format!("{} has vanished", entry.id),
    };
    match &stages.stages[..] {
        [] => "no stage yet".to_owned(),
        stages => stages.iter().map(stage).collect::<Vec<_>>().join(" · "),
    }
}
