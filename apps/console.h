#pragma once

#include <atomic>
#include <string>

#include "core/progress.h"

/// The terminal: progress bar, colours, signals.
namespace sekitei::apps {

/// Set by the first SIGINT or SIGTERM; a second one ends the process at once (temporary files are
/// swept by the next run; final names are never half-written).
extern std::atomic<bool> g_stop;

/// Puts /dev/null where standard input, output or error is closed, opened the wrong way round so
/// that use still fails: otherwise the next file opened takes the number, and words end up in data.
void hold_standard_descriptors();

/// Installs handlers for SIGINT, SIGTERM; ignores SIGPIPE and SIGXFSZ so that writes
/// report EPIPE and EFBIG.
void install_signal_handlers();

/// 130 or 143, by the signal that came; 130 if none did.
int interrupted_exit_code();

/// Progress that draws a bar on standard error if it is a terminal, and otherwise nothing.
Progress console_progress(const std::string& stage);

/// Clears a bar that is being shown.
void clear_progress_line();

bool stderr_is_terminal();
/// True on a terminal unless NO_COLOR is set.
bool use_colour();

/// Seconds as people say them: "3.2 s", "4 min 10 s".
std::string duration_text(double seconds);

}  // namespace sekitei::apps
