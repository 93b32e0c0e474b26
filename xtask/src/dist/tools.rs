//! What a library needs of the machine that it runs on, as binutils reads it from the file.

use std::path::Path;
use std::process::Command;

use anyhow::Result;

use super::output;

/// Where the library looks for those that it needs, before the system's folders.
pub fn run_paths(library: &Path) -> Result<Vec<String>> {
    Ok(parse_run_paths(&readelf("--dynamic", library)?))
}

/// The oldest glibc that has all that the library needs: major and minor version.
pub fn glibc(library: &Path) -> Result<(u32, u32)> {
    Ok(parse_glibc(&readelf("--version-info", library)?))
}

fn readelf(what: &str, library: &Path) -> Result<String> {
    output(Command::new("readelf").env("LC_ALL", "C").args(["--wide", what]).arg(library))
}

/// From lines such as `0x000000000000001d (RUNPATH)  Library runpath: [$ORIGIN:/usr/lib]`.
fn parse_run_paths(text: &str) -> Vec<String> {
    let lines = text.lines().filter(|line| line.contains("(RUNPATH)") || line.contains("(RPATH)"));
    let values = lines.filter_map(|line| line.split_once('[')?.1.split_once(']'));
    values.flat_map(|(paths, _)| paths.split(':')).map(str::to_owned).collect()
}

/// From lines such as `0x0010:   Name: GLIBC_2.34  Flags: none  Version: 5`; (0, 0) if it needs none.
fn parse_glibc(text: &str) -> (u32, u32) {
    let versions = text.split_whitespace().filter_map(|word| {
        let mut numbers = word.strip_prefix("GLIBC_")?.split('.').map(str::parse);
        Some((numbers.next()?.ok()?, numbers.next()?.ok()?))
    });
    versions.max().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_run_path_and_the_newest_glibc_are_found() {
        let dynamic = " 0x000000000000000f (RPATH)              Library rpath: [/home/a/target]
 0x000000000000001d (RUNPATH)            Library runpath: [$ORIGIN:/usr/lib]
 0x0000000000000001 (NEEDED)             Shared library: [libm.so.6]\n";
        assert_eq!(parse_run_paths(dynamic), ["/home/a/target", "$ORIGIN", "/usr/lib"]);
        assert!(parse_run_paths("There is no dynamic section in this file.").is_empty());
        let needs = "  0x0010:   Name: GLIBC_2.9  Flags: none  Version: 7
  0x0020:   Name: GLIBC_2.34  Flags: none  Version: 5
  0x0030:   Name: GLIBC_2.2.5  Flags: none  Version: 4
  0x0040:   Name: GCC_4.2.0  Flags: none  Version: 3
  0x0050:   Name: GLIBC_PRIVATE  Flags: none  Version: 2\n";
        assert_eq!(parse_glibc(needs), (2, 34));
        assert_eq!(parse_glibc(""), (0, 0));
    }
}
