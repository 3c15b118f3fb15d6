#pragma once

namespace sekitei::apps {

/// Understands the command line, runs the command, turns failures into messages and exit codes.
int run_command_line(int argc, char** argv);

}  // namespace sekitei::apps
