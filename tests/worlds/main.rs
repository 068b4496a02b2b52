//! Worlds: recipes, specimens, truth, images, files, pages; living worlds, recorded series, and the scores of agents.

mod build;
#[path = "../common/cases.rs"]
mod cases;
mod clusters;
#[path = "../common/mod.rs"]
mod common;
mod contributing;
mod detectors;
#[path = "../common/dm_bytes.rs"]
mod dm_bytes;
mod domains;
mod episodes;
mod epitaxy;
mod examples;
mod film;
mod layers;
mod library;
mod live;
mod mosaic;
mod own_atoms;
mod pages;
mod particle_refusals;
mod particles;
mod pictures;
#[path = "../common/python.rs"]
mod python;
mod recipes;
mod recorded_axes;
mod regions;
mod repeating_columns;
mod replay;
mod samples;
mod scores;
mod several_detectors;
#[path = "../common/skipped.rs"]
mod skipped;
mod specimen;
#[path = "../common/specimens.rs"]
mod specimens;
mod stack;
mod stack_defects;
mod stack_particles;
mod tiles;
mod truth;
mod vacancy_groups;
