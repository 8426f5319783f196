//! Sessions in a viewer that runs.
//!
//! What is sent goes through a thread of its own: however a viewer behaves, whoever sends is never held up, and
//! in the end waits no longer than [`PATIENCE`].

use crate::error::RecordingError;
use crate::recording::{self, Recorder};
use crate::scene::{Iteration, Scene};
use crate::sdk::SpawnOptions;
use crate::sdk::external::re_uri::ProxyUri;
use crate::{DEFAULT_URL, Layout, VIEWER_VERSION, Viewer};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A viewer takes what it was sent within this time, or is given up.
const PATIENCE: Duration = Duration::from_secs(60);
/// ... and answers, or has started, within these.
const ANSWERS: Duration = Duration::from_secs(3);
const STARTS: Duration = Duration::from_secs(20);

/// What is sent.
enum Event {
    Begin(Box<Scene>),
    Iteration(Box<Iteration>),
    End(Box<Scene>),
    Whole(Vec<Scene>),
}

/// A session that is live: the start, iterations as they come, and the end.
pub struct Live {
    events: Sender<Event>,
    done: Receiver<Result<(), RecordingError>>,
    thread: JoinHandle<()>,
}

/// Shows whole scenes.
pub fn show(scenes: Vec<Scene>, layout: Layout, viewer: &Viewer) -> Result<(), RecordingError> {
    let live = Live::open(viewer, layout)?;
    // A thread that is gone says why at the end.
    let _ = live.events.send(Event::Whole(scenes));
    live.wait()
}

impl Live {
    /// Opens a session; an error where no viewer answers.
    pub fn open(viewer: &Viewer, layout: Layout) -> Result<Live, RecordingError> {
        let url = match viewer {
            Viewer::Spawned => spawn()?,
            Viewer::At(url) => url.clone(),
        };
        wait_for(&url, if *viewer == Viewer::Spawned { STARTS } else { ANSWERS })?;
        let (events, received) = channel();
        let (tell, done) = channel();
        let thread = std::thread::spawn(move || {
            // Nobody may be there any more to hear it.
            let _ = tell.send(send(&url, layout, &received));
        });
        Ok(Live { events, done, thread })
    }

    /// Shows the start.
    pub fn begin(&self, scene: Scene) {
        let _ = self.events.send(Event::Begin(Box::new(scene)));
    }

    /// Shows an iteration.
    pub fn iteration(&self, iteration: Iteration) {
        let _ = self.events.send(Event::Iteration(Box::new(iteration)));
    }

    /// Shows the end, and waits until the viewer has all.
    pub fn end(self, scene: Scene) -> Result<(), RecordingError> {
        let _ = self.events.send(Event::End(Box::new(scene)));
        self.wait()
    }

    fn wait(self) -> Result<(), RecordingError> {
        let Live { events, done, thread } = self;
        drop(events);
        match done.recv_timeout(PATIENCE) {
            Ok(sent) => {
                // It ends with what it told.
                let _ = thread.join();
                sent
            }
            Err(_) => Err(RecordingError::Lost("it did not take what it was sent".to_owned())),
        }
    }
}

/// Sends events as they come.
fn send(url: &str, layout: Layout, events: &Receiver<Event>) -> Result<(), RecordingError> {
    let lost = |error: &dyn std::fmt::Display| RecordingError::Lost(error.to_string());
    let mut stream = None;
    let mut iterations = 0;
    let mut begun: Option<Box<Scene>> = None;
    for event in events {
        match event {
            Event::Whole(scenes) => {
                let opened = recording::builder(&scenes).connect_grpc_opts(url)?;
                recording::record(&opened, &scenes, layout)?;
                stream = Some(opened);
            }
            Event::Begin(scene) => {
                let opened = recording::builder(std::slice::from_ref(&scene)).connect_grpc_opts(url)?;
                recording::begin(&opened, std::slice::from_ref(&scene), layout)?;
                Recorder::new(&opened, &scene).start()?;
                stream = Some(opened);
                begun = Some(scene);
            }
            Event::Iteration(iteration) => {
                if let (Some(stream), Some(scene)) = (&stream, &begun) {
                    Recorder::new(stream, scene).iteration(iterations, &iteration)?;
                    iterations += 1;
                }
            }
            Event::End(scene) => {
                if let Some(stream) = &stream {
                    // Bodies and references are known only now, and with them what there is to open.
                    recording::begin(stream, std::slice::from_ref(&scene), layout)?;
                    Recorder::new(stream, &scene).end()?;
                }
            }
        }
    }
    let Some(stream) = stream else { return Ok(()) };
    stream.flush_with_timeout(PATIENCE).map_err(|error| lost(&error))
}

/// Starts a viewer, unless one listens already, and says where it listens. It listens to this machine alone.
fn spawn() -> Result<String, RecordingError> {
    let options = SpawnOptions {
        extra_args: vec!["--bind".to_owned(), "127.0.0.1".to_owned()],
        hide_welcome_screen: true,
        ..SpawnOptions::default()
    };
    let spawned = crate::sdk::spawn(&options).map_err(|error| {
        let install = format!(
            "install it with `pip install rerun-sdk=={VIEWER_VERSION}` or `cargo binstall rerun-cli@{VIEWER_VERSION}`"
        );
        RecordingError::NoViewer(match error {
            crate::sdk::SpawnError::Io(error) => format!("the viewer `rerun` could not be started ({error}): {install}"),
            _ => format!("the viewer `rerun` is not on the PATH: {install}"),
        })
    })?;
    Ok(format!("rerun+http://127.0.0.1:{}/proxy", spawned.port))
}

/// Waits until somebody listens at `url`.
fn wait_for(url: &str, patience: Duration) -> Result<(), RecordingError> {
    let wrong = |why: &dyn std::fmt::Display| {
        RecordingError::NoViewer(format!("{url} is no address of a viewer, such as {DEFAULT_URL}: {why}"))
    };
    let uri: ProxyUri = url.parse().map_err(|error| wrong(&error))?;
    let place = (uri.origin.host.to_string(), uri.origin.port);
    let addresses: Vec<_> = place.to_socket_addrs().map_err(|error| wrong(&error))?.collect();
    let begin = Instant::now();
    loop {
        let left = patience.saturating_sub(begin.elapsed());
        let is_there = addresses
            .iter()
            .any(|at| TcpStream::connect_timeout(at, left.max(Duration::from_millis(100))).is_ok());
        if is_there {
            return Ok(());
        }
        if left.is_zero() || patience == ANSWERS {
            return Err(RecordingError::NoViewer(format!(
                "no viewer listens at {url}: start one with `rerun --bind 127.0.0.1` (version {VIEWER_VERSION}:                  `pip install rerun-sdk=={VIEWER_VERSION}`)"
            )));
        }
        std::thread::sleep(Duration::from_millis(200));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    fn scene() -> Scene {
        Scene { name: "test".to_owned(), ..Scene::default() }
    }

    #[test]
    fn where_nobody_listens_there_is_no_session() {
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let url = format!("rerun+http://127.0.0.1:{port}/proxy");
        let error = show(vec![scene()], Layout::Overview, &Viewer::At(url.clone())).unwrap_err();
        assert!(error.to_string().starts_with(&format!("no viewer listens at {url}: start one")), "{error}");
        assert!(error.to_string().contains("pip install rerun-sdk"), "{error}");
        let error = show(vec![scene()], Layout::Overview, &Viewer::At("over there".to_owned())).unwrap_err();
        assert!(error.to_string().starts_with("over there is no address of a viewer"), "{error}");
    }

    #[test]
    fn a_viewer_that_goes_away_is_told_and_holds_nobody_up() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("rerun+http://{}/proxy", listener.local_addr().unwrap());
        let live = Live::open(&Viewer::At(url), Layout::Overview).unwrap();
        let goes = std::thread::spawn(move || {
            // It answers, takes a little, and is gone.
            let taken: Vec<_> = (0..2).map(|_| listener.accept().unwrap()).collect();
            drop((taken, listener));
        });
        live.begin(scene());
        for _ in 0..200 {
            live.iteration(Iteration::default());
        }
        goes.join().unwrap();
        let error = live.end(scene()).unwrap_err();
        assert!(matches!(error, RecordingError::Lost(_)), "{error}");
    }
}
