//! Where plugins are looked for.

use std::{
    env,
    ffi::OsString,
    path::{Path, PathBuf},
};

/// The folders that are scanned for plugins, in order. Subfolders are not entered.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SearchPath {
    folders: Vec<PathBuf>,
}

impl SearchPath {
    /// The environment variable with folders of the user's own, separated as in `PATH`.
    pub const VARIABLE: &'static str = "SHIELD_PLUGIN_PATH";

    /// Exactly these folders.
    pub fn new(folders: impl IntoIterator<Item = impl Into<PathBuf>>) -> Self {
        Self { folders: folders.into_iter().map(Into::into).collect() }
    }

    /// The usual folders: those in `SHIELD_PLUGIN_PATH`; the executable's, and `plugins` in it; `shield/plugins` in the user's data
    /// folder, which is `XDG_DATA_HOME` or `~/.local/share`.
    pub fn from_environment() -> Self {
        let executable = env::current_exe().and_then(|path| path.canonicalize()).ok();
        Self::around(executable.as_deref().and_then(Path::parent))
    }

    /// The usual folders, for a library that is loaded into a program of somebody else's: `folder`, and `plugins` in it, stand in for
    /// those of the executable.
    pub fn beside(folder: &Path) -> Self {
        Self::around(Some(folder))
    }

    fn around(folder: Option<&Path>) -> Self {
        let variable = |name: &str| env::var_os(name).filter(|value| !value.is_empty());
        Self::from_parts(variable(Self::VARIABLE), folder, variable("XDG_DATA_HOME"), variable("HOME"))
    }

    fn from_parts(
        variable: Option<OsString>,
        executable_folder: Option<&Path>,
        data_home: Option<OsString>,
        home: Option<OsString>,
    ) -> Self {
        let mut folders: Vec<PathBuf> = variable
            .iter()
            .flat_map(env::split_paths)
            .filter(|folder| !folder.as_os_str().is_empty())
            .collect();
        if let Some(folder) = executable_folder {
            folders.extend([folder.to_path_buf(), folder.join("plugins")]);
        }
        let data_home =
            data_home.map(PathBuf::from).or_else(|| home.map(|home| Path::new(&home).join(".local/share")));
        folders.extend(data_home.map(|folder| folder.join("shield/plugins")));
        Self { folders }
    }

    /// The folders, in the order in which they are scanned. Some may not exist.
    pub fn folders(&self) -> &[PathBuf] {
        &self.folders
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folders(variable: Option<&str>, data_home: Option<&str>) -> Vec<String> {
        let (variable, data_home) = (variable.map(OsString::from), data_home.map(OsString::from));
        SearchPath::from_parts(variable, Some(Path::new("/bin")), data_home, Some("/home/a".into()))
            .folders()
            .iter()
            .map(|folder| folder.display().to_string())
            .collect()
    }

    #[test]
    fn the_users_folders_come_first_and_empty_ones_are_dropped() {
        let found = folders(Some("/one::/two"), None);
        assert_eq!(found, ["/one", "/two", "/bin", "/bin/plugins", "/home/a/.local/share/shield/plugins"]);
    }

    #[test]
    fn xdg_data_home_wins_over_the_home_folder() {
        assert_eq!(folders(None, Some("/data")), ["/bin", "/bin/plugins", "/data/shield/plugins"]);
    }
}
