//! What a page is made of: sections of text, tables and figures, in a form that the template lays out.

use super::figure::Figure;
use serde::Serialize;

/// A section.
#[derive(Clone, Debug, Serialize)]
pub struct Section {
    /// Its place in links.
    pub id: &'static str,
    /// Its heading.
    pub title: &'static str,
    /// What is in it.
    pub blocks: Vec<Block>,
}

impl Section {
    /// An empty section.
    pub fn new(id: &'static str, title: &'static str) -> Self {
        Section { id, title, blocks: Vec::new() }
    }

    /// Adds a paragraph that stands out.
    pub fn strong(&mut self, text: impl Into<String>) {
        self.blocks.push(Block::Strong { text: text.into() });
    }

    /// Adds a paragraph.
    pub fn text(&mut self, text: impl Into<String>) {
        self.blocks.push(Block::Text { text: text.into() });
    }

    /// Says why something is not there.
    pub fn empty(&mut self, why: impl Into<String>) {
        self.blocks.push(Block::Empty { why: why.into() });
    }

    /// Adds a heading below that of the section.
    pub fn heading(&mut self, text: impl Into<String>) {
        self.blocks.push(Block::Heading { text: text.into() });
    }

    /// Adds a table; nothing where it has no rows.
    pub fn table(&mut self, table: Table) {
        if !table.rows.is_empty() {
            self.blocks.push(Block::Table(table));
        }
    }

    /// Adds drawings side by side under one caption; says so where there is nothing to draw.
    pub fn figures(
        &mut self,
        name: impl Into<String>,
        caption: impl Into<String>,
        drawings: &[(&str, Figure)],
    ) {
        let (name, caption) = (name.into(), caption.into());
        let panels: Vec<Panel> = drawings
            .iter()
            .filter_map(|(label, figure)| {
                Some(Panel { label: (*label).to_owned(), svg: figure.svg(drawings.len() > 1)? })
            })
            .collect();
        if panels.is_empty() {
            self.empty(format!("{name} is empty: there is nothing to draw."));
        } else {
            self.blocks.push(Block::Figure { name, caption, panels });
        }
    }
}

/// A piece of a section.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Block {
    /// A paragraph.
    Text {
        /// Its text.
        text: String,
    },
    /// A paragraph that stands out.
    Strong {
        /// Its text.
        text: String,
    },
    /// Why something is not there.
    Empty {
        /// The reason.
        why: String,
    },
    /// A heading.
    Heading {
        /// Its text.
        text: String,
    },
    /// A list.
    List {
        /// Its items.
        items: Vec<String>,
    },
    /// A table.
    Table(Table),
    /// A table whose cells are shaded by their values.
    Grid(Grid),
    /// Drawings side by side.
    Figure {
        /// By which it is quoted.
        name: String,
        /// What it shows.
        caption: String,
        /// The drawings.
        panels: Vec<Panel>,
    },
}

/// A drawing of a figure.
#[derive(Clone, Debug, Serialize)]
pub struct Panel {
    /// What tells it from its neighbours.
    pub label: String,
    /// The drawing.
    pub svg: String,
}

/// A table whose cells are shaded by their values.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Grid {
    /// What it says.
    pub caption: String,
    /// What lies down and across.
    pub corner: String,
    /// Its head.
    pub head: Vec<String>,
    /// Its rows.
    pub rows: Vec<GridRow>,
}

/// A row of a grid.
#[derive(Clone, Debug, Default, Serialize)]
pub struct GridRow {
    /// What it is of.
    pub label: String,
    /// Its cells.
    pub cells: Vec<GridCell>,
}

/// A cell of a grid.
#[derive(Clone, Debug, Default, Serialize)]
pub struct GridCell {
    /// What it says.
    pub text: String,
    /// What is said where one points at it.
    pub more: String,
    /// Its colour and that of its letters.
    pub colour: String,
    /// See `colour`.
    pub ink: &'static str,
    /// Whether it has a frame.
    pub marked: bool,
}

impl GridCell {
    /// A cell shaded by a share, from 0 (pale) to 1 (dark); grey where it has none.
    pub fn shaded(text: String, more: String, share: Option<f64>) -> Self {
        let Some(share) = share.filter(|share| share.is_finite()) else {
            return GridCell { text, more, colour: "#ddd".to_owned(), ink: "#111", marked: false };
        };
        let share = share.clamp(0.0, 1.0);
        // Darker is worse, from nearly white to deep blue.
        let mix = |pale: f64, dark: f64| (pale + share * (dark - pale)).round() as u8;
        let colour = format!("#{:02x}{:02x}{:02x}", mix(238.0, 8.0), mix(245.0, 48.0), mix(252.0, 107.0));
        let ink = if share > 0.5 { "#fff" } else { "#111" };
        GridCell { text, more, colour, ink, marked: false }
    }
}

/// A table.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Table {
    /// What it says.
    pub caption: String,
    /// Its head.
    pub head: Vec<String>,
    /// Its rows.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// A table without rows.
    pub fn new(caption: impl Into<String>, head: &[&str]) -> Self {
        let head = head.iter().map(|cell| (*cell).to_owned()).collect();
        Table { caption: caption.into(), head, rows: Vec::new() }
    }

    /// Adds a row.
    pub fn row<const N: usize>(&mut self, cells: [String; N]) {
        self.rows.push(cells.into());
    }
}

/// A number that a reader should see first.
#[derive(Clone, Debug, Serialize)]
pub struct Headline {
    /// What it is of.
    pub name: String,
    /// The number with its unit.
    pub value: String,
    /// What it means.
    pub meaning: String,
    /// More of it.
    pub more: String,
    /// Where the rest stands.
    pub link: &'static str,
}
