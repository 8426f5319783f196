//! Packages of others: what is hot is compiled optimised, and what comes in may come in.

use crate::support::in_package;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Packages of the program without the viewer that may stay unoptimised, and why. A new one is named here, or
/// in both lists of profiles of Cargo.toml.
const NOT_HOT: &[(&str, &[&str])] = &[
    (
        "generic or inlined: compiled in the packages that use it, at their level",
        &[
            "aligned-vec",
            "approx",
            "argmin",
            "argmin-math",
            "array-init",
            "arrayvec",
            "atomic-wait",
            "az",
            "bitflags",
            "block-buffer",
            "bytemuck",
            "cfg-if",
            "crossbeam",
            "crossbeam-channel",
            "crossbeam-deque",
            "crossbeam-epoch",
            "crossbeam-queue",
            "crossbeam-utils",
            "crypto-common",
            "derive_builder",
            "digest",
            "dyn-stack",
            "either",
            "equator",
            "equivalent",
            "faer-traits",
            "float_eq",
            "generativity",
            "generator",
            "generic-array",
            "hash32",
            "hashbrown",
            "heapless",
            "indexmap",
            "itertools",
            "memo-map",
            "nalgebra",
            "nonmax",
            "num-complex",
            "num-integer",
            "num-rational",
            "num-traits",
            "ordered-float",
            "pulp-wasm-simd-flag",
            "reborrow",
            "safe_arch",
            "simba",
            "smallvec",
            "sorted-vec",
            "stable_deref_trait",
            "typenum",
            "wide",
            "zerocopy",
            "zeroize",
        ],
    ),
    (
        "matrices of other numbers than f64, which the symbolic part of faer brings along",
        &[
            "gemm-c32",
            "gemm-c64",
            "gemm-f32",
            "half",
            "nano-gemm-c32",
            "nano-gemm-c64",
            "nano-gemm-core",
            "nano-gemm-f32",
            "qd",
        ],
    ),
    (
        "asked once, or now and then",
        &[
            "amd",
            "anyhow",
            "chrono",
            "cmov",
            "constant_time_eq",
            "cpufeatures",
            "errno",
            "fastrand",
            "getrandom",
            "iana-time-zone",
            "lazy_static",
            "libc",
            "libm",
            "linux-raw-sys",
            "log",
            "num_cpus",
            "once_cell",
            "pin-project-lite",
            "portable-atomic",
            "quick-error",
            "rand",
            "rand_core",
            "rand_xoshiro",
            "raw-cpuid",
            "rustix",
            "serde",
            "serde-big-array",
            "serde_core",
            "signal-hook",
            "signal-hook-registry",
            "tempfile",
            "thiserror",
            "tracing",
            "tracing-core",
            "uuid",
            "web-time",
        ],
    ),
    (
        "the command line",
        &[
            "anstream",
            "anstyle",
            "anstyle-parse",
            "anstyle-query",
            "clap",
            "clap_builder",
            "clap_complete",
            "clap_lex",
            "colorchoice",
            "console",
            "indicatif",
            "is_terminal_polyfill",
            "strsim",
            "terminal_size",
            "unicode-width",
            "unit-prefix",
            "utf8parse",
        ],
    ),
    (
        "settings, sentences and reports: small texts",
        &[
            "aho-corasick",
            "geodesy",
            "imagesize",
            "itoa",
            "nmea",
            "nom",
            "peg",
            "peg-runtime",
            "regex",
            "regex-automata",
            "regex-syntax",
            "roxmltree",
            "serde_json",
            "serde_spanned",
            "toml",
            "toml_datetime",
            "toml_parser",
            "toml_writer",
            "winnow",
            "zmij",
        ],
    ),
    (
        "pages and archives",
        &["minijinja", "plotters", "plotters-backend", "plotters-svg", "typed-path", "zip"],
    ),
];

/// Licences under which a package may come in. (A licence file that is read by people is named below.)
const LICENCES: &[&str] = &[
    "0BSD",
    "Apache-2.0",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "ISC",
    "MIT",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
];

/// Packages that name no licence but bring its text, and which it is.
const READ_LICENCES: &[(&str, &str)] = &[("pcd-rs", "MIT")];

/// What `cargo tree` says of each package, a row each, the columns divided by bars.
fn tree(arguments: &[&str], format: &str) -> BTreeSet<String> {
    let run = Command::new(env!("CARGO"))
        .args(["tree", "--offline", "--locked", "--prefix", "none", "--format", format])
        .args(arguments)
        .current_dir(in_package(""))
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let text = String::from_utf8(run.stdout).unwrap();
    text.lines().map(|line| line.trim_end_matches(" (*)").to_owned()).collect()
}

/// Names of the packages of others that the program links, without the viewer.
fn linked() -> BTreeSet<String> {
    let program = ["--package", "trackbundle", "--no-default-features", "--features", "program"];
    let rows = tree(&[&program[..], &["--edges", "normal,no-proc-macro"]].concat(), "{p}");
    let names = rows.iter().filter_map(|row| row.split(' ').next());
    names.filter(|name| !name.is_empty() && !name.starts_with("trackbundle")).map(str::to_owned).collect()
}

/// Levels of optimisation of the packages that a profile names.
fn levels(profile: &str) -> BTreeMap<String, i64> {
    let manifest: toml::Table = std::fs::read_to_string(in_package("Cargo.toml")).unwrap().parse().unwrap();
    let packages = manifest["profile"][profile]["package"].as_table().unwrap();
    let level = |value: &toml::Value| value["opt-level"].as_integer().unwrap();
    let others = packages.iter().filter(|(name, _)| *name != "*" && !name.starts_with("trackbundle"));
    others.map(|(name, value)| (name.clone(), level(value))).collect()
}

#[test]
fn what_is_hot_is_compiled_optimised() {
    let (linked, release) = (linked(), levels("release"));
    assert!(linked.len() > 100, "{linked:?}");
    let cold: BTreeSet<String> =
        NOT_HOT.iter().flat_map(|(_, names)| *names).map(|name| (*name).to_owned()).collect();
    for name in &linked {
        let (is_hot, is_cold) = (release.contains_key(name), cold.contains(name));
        assert!(
            is_hot || is_cold,
            "{name} is neither among the profiles of Cargo.toml nor said not to be hot"
        );
        assert!(!(is_hot && is_cold), "{name} is hot and not hot");
    }
    for name in release.keys().chain(&cold) {
        assert!(linked.contains(name), "{name} is no package of the program");
    }
    assert!(release.values().all(|level| *level == 3));
}

#[test]
fn both_profiles_name_the_same_packages() {
    assert_eq!(levels("release"), levels("dev"));
}

/// Whether an expression of licences, of SPDX or with a slash for "or", lets a package in.
fn is_allowed(expression: &str) -> bool {
    let or = expression.replace('/', " OR ").replace(" WITH LLVM-exception", "");
    // "and" binds faster; an expression in parentheses stands on one side of an "and" here.
    let either = |text: &str| text.split(" OR ").any(|one| LICENCES.contains(&one.trim()));
    if or.contains('(') {
        return or.split(" AND ").all(|all| either(all.trim().trim_matches(['(', ')'])));
    }
    or.split(" OR ").any(|one| one.split(" AND ").all(either))
}

#[test]
fn licences_let_every_package_in() {
    let rows = tree(&["--workspace", "--edges", "normal,build,dev"], "{p}|{l}");
    assert!(rows.len() > 300, "{}", rows.len());
    for row in rows.iter().filter(|row| !row.is_empty()) {
        let (package, licence) = row.split_once('|').unwrap();
        let name = package.split(' ').next().unwrap();
        let read = READ_LICENCES.iter().find(|(known, _)| *known == name).map(|(_, licence)| *licence);
        let licence = if licence.is_empty() { read.unwrap_or_default() } else { licence };
        assert!(is_allowed(licence), "{package} is under {licence:?}");
    }
    assert!(is_allowed("(MIT OR Apache-2.0) AND Unicode-3.0") && is_allowed("Apache-2.0 / GPL-3.0"));
    assert!(!is_allowed("GPL-3.0") && !is_allowed("") && !is_allowed("MIT AND GPL-3.0"));
    assert!(!is_allowed("(MIT OR Apache-2.0) AND GPL-3.0"));
}

#[test]
fn packages_come_from_the_registry() {
    let lock: toml::Table = std::fs::read_to_string(in_package("Cargo.lock")).unwrap().parse().unwrap();
    for package in lock["package"].as_array().unwrap() {
        let (name, source) = (package["name"].as_str().unwrap(), package.get("source"));
        let is_ours = name.starts_with("trackbundle");
        let from = source.map(|source| source.as_str().unwrap());
        let wanted = (!is_ours).then_some("registry+https://github.com/rust-lang/crates.io-index");
        assert_eq!(from, wanted, "{name}");
    }
}
