//! The viewer's layout: views and containers under fixed identifiers, logged property by property, because the typed
//! interface has no way to set axes, bounds and legends.

use super::names::{APPLICATION_ID, Result, VALID_TIME};
use re_sdk::external::re_log_types::BlueprintActivationCommand;
use re_sdk::sink::MemorySinkStorage;
use re_sdk::{RecordingStream, RecordingStreamBuilder};
use re_sdk_types::blueprint::{archetypes as archetype, components as component};
use re_sdk_types::datatypes::{Range2D, TimeRange, TimeRangeBoundary, Uuid};

/// The classes of views; the number of each is part of the identifiers of its views.
#[derive(Clone, Copy, Debug)]
enum Class {
    Map = 1,
    Curves,
    Document,
    Log,
}

/// A layout that is being built.
pub struct Blueprint {
    stream: RecordingStream,
    storage: MemorySinkStorage,
    count: u16,
}

/// A view or container: its path.
#[derive(Clone, Debug)]
pub struct Part(String);

/// How a container arranges its parts.
#[derive(Clone, Copy, Debug)]
pub enum Arrangement<'a> {
    /// Behind each other.
    Tabs,
    /// In rows of this length.
    Grid(u32),
    /// Beside each other, equally wide.
    Horizontal,
    /// Below each other, with their shares of the height.
    Vertical(&'a [f32]),
}

impl Blueprint {
    /// An empty layout.
    pub fn new() -> Result<Self> {
        let builder = RecordingStreamBuilder::new(APPLICATION_ID).recording_id("isobar-layout").blueprint();
        let (stream, storage) = builder.send_properties(false).memory()?;
        stream.set_time_sequence("blueprint", 0);
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        Ok(Self { stream, storage, count: 0 })
    }

    /// A map with the given bounds in x and y.
    pub fn map(&mut self, name: &str, contents: &[String], [x, y]: [[f64; 2]; 2]) -> Result<Part> {
        let part = self.view(Class::Map, name, contents)?;
        let range = Range2D { x_range: x.into(), y_range: y.into() };
        let bounds = archetype::VisualBounds2D::new(component::VisualBounds2D(range));
        self.stream.log(part.property("VisualBounds2D"), &bounds)?;
        Ok(part)
    }

    /// Curves over the whole run, with the given range of values, and with or without a legend.
    pub fn curves(&mut self, name: &str, contents: &[String], range: Option<[f64; 2]>, legend: bool) -> Result<Part> {
        let part = self.view(Class::Curves, name, contents)?;
        if let Some(range) = range {
            self.stream.log(part.property("ScalarAxis"), &archetype::ScalarAxis::new().with_range(range))?;
        }
        let legend = archetype::PlotLegend::new().with_corner(component::Corner2D::RightTop).with_visible(legend);
        self.stream.log(part.property("PlotLegend"), &legend)?;
        let whole = TimeRange { start: TimeRangeBoundary::Infinite, end: TimeRangeBoundary::Infinite };
        let axis = archetype::TimeAxis::new().with_view_range(component::TimeRange(whole));
        self.stream.log(part.property("TimeAxis"), &axis)?;
        Ok(part)
    }

    /// A text.
    pub fn document(&mut self, name: &str, entity: &str) -> Result<Part> {
        self.view(Class::Document, name, &[entity.into()])
    }

    /// A log of texts over time.
    pub fn log(&mut self, name: &str, contents: &[String]) -> Result<Part> {
        self.view(Class::Log, name, contents)
    }

    /// A container of the parts.
    pub fn container(&mut self, name: &str, arrangement: Arrangement<'_>, parts: &[Part]) -> Result<Part> {
        self.container_with_id(name, arrangement, parts).map(|(part, _)| part)
    }

    /// Ends the layout with its outermost container, and sends it to the recording, which plays `playback_speed` seconds of
    /// valid time per second.
    pub fn send(mut self, recording: &RecordingStream, tabs: &[Part], playback_speed: f64) -> Result {
        let (_, id) = self.container_with_id("isobar", Arrangement::Tabs, tabs)?;
        let viewport = archetype::ViewportBlueprint::new().with_root_container(component::RootContainer(id));
        self.stream.log("viewport", &viewport.with_auto_layout(false).with_auto_views(false))?;
        let time = archetype::TimePanelBlueprint::new()
            .with_state(component::PanelState::Collapsed)
            .with_timeline(VALID_TIME)
            .with_playback_speed(playback_speed)
            .with_play_state(component::PlayState::Following);
        self.stream.log("time_panel", &time)?;
        for panel in ["blueprint_panel", "selection_panel"] {
            let hidden = archetype::PanelBlueprint::new().with_state(component::PanelState::Hidden);
            self.stream.log(panel, &hidden)?;
        }
        self.stream.flush_blocking()?;
        let messages = self.storage.take();
        let Some(blueprint_id) = messages.first().map(|message| message.store_id().clone()) else {
            return Err("the viewer's layout is empty".into());
        };
        let command = BlueprintActivationCommand { blueprint_id, make_active: true, make_default: true };
        recording.send_blueprint(messages, command);
        Ok(())
    }

    fn view(&mut self, class: Class, name: &str, contents: &[String]) -> Result<Part> {
        let part = Part(format!("view/{}", self.next_id(class as u8).1));
        let queries = contents.iter().map(|entity| component::QueryExpression(format!("+ /{entity}").into()));
        self.stream.log(part.property("ViewContents"), &archetype::ViewContents::new(queries))?;
        let view = archetype::ViewBlueprint::new(component::ViewClass(class.name().into())).with_display_name(name);
        self.stream.log(part.0.as_str(), &view.with_space_origin("/"))?;
        Ok(part)
    }

    fn container_with_id(&mut self, name: &str, arrangement: Arrangement<'_>, parts: &[Part]) -> Result<(Part, Uuid)> {
        let (bytes, id) = self.next_id(0);
        let part = Part(format!("container/{id}"));
        let kind = match arrangement {
            Arrangement::Tabs => component::ContainerKind::Tabs,
            Arrangement::Grid(_) => component::ContainerKind::Grid,
            Arrangement::Horizontal => component::ContainerKind::Horizontal,
            Arrangement::Vertical(_) => component::ContainerKind::Vertical,
        };
        let contents = parts.iter().map(|part| component::IncludedContent(part.0.as_str().into()));
        let container = archetype::ContainerBlueprint::new(kind).with_display_name(name).with_contents(contents);
        let container = match (arrangement, parts.first()) {
            (Arrangement::Tabs, Some(first)) => container.with_active_tab(first.0.as_str()),
            (Arrangement::Grid(columns), _) => container.with_grid_columns(component::GridColumns(columns.into())),
            (Arrangement::Vertical(shares), _) => {
                container.with_row_shares(shares.iter().map(|&share| component::RowShare(share.into())))
            }
            _ => container,
        };
        self.stream.log(part.0.as_str(), &container)?;
        Ok((part, Uuid { bytes }))
    }

    /// The next identifier, as bytes and as text; `class` is 0 for containers. A viewer that has shown another layout keeps the
    /// state of each view under its identifier, and fails if a view of another class now has that identifier.
    fn next_id(&mut self, class: u8) -> ([u8; 16], String) {
        self.count += 1;
        let mut bytes = [0; 16];
        bytes[9] = class;
        bytes[14..].copy_from_slice(&self.count.to_be_bytes());
        (bytes, format!("00000000-0000-0000-00{class:02x}-{:012x}", self.count))
    }
}

impl Class {
    /// What the viewer calls it.
    fn name(self) -> &'static str {
        match self {
            Self::Map => "2D",
            Self::Curves => "TimeSeries",
            Self::Document => "TextDocument",
            Self::Log => "TextLog",
        }
    }
}

impl Part {
    fn property(&self, name: &str) -> String {
        format!("{}/{name}", self.0)
    }
}
