#pragma once

#include <stdexcept>
#include <string>

/// What can go wrong, and the exit code that tells a script which kind it was.
///
/// Only apps/ catches. Messages have one shape: where, what was found, what was expected, how to
/// mend it.
namespace sekitei {

enum class ExitCode {
    Done = 0,
    Bug = 1,           ///< a defect of Sekitei
    Usage = 2,         ///< bad command line, recipe or parameter
    BadInput = 3,      ///< a file or grid that cannot be used
    CannotWrite = 4,   ///< disk full, read-only, no such folder
    Limit = 5,         ///< memory, time or voxels; the message names what would be needed
    Differ = 6,        ///< `diff` and `verify`
    Interrupted = 130  ///< can be resumed
};

class Error : public std::runtime_error {
public:
    Error(ExitCode code, const std::string& message) : std::runtime_error(message), code_(code) {}
    ExitCode code() const { return code_; }

private:
    ExitCode code_;
};

/// The caller can mend it: a file, a grid or a mesh that does not fit.
struct InvalidInput : Error {
    explicit InvalidInput(const std::string& message, ExitCode code = ExitCode::BadInput)
        : Error(code, message)
    {
    }
};

/// A parameter, option or recipe key out of its range.
struct InvalidParameter : InvalidInput {
    explicit InvalidParameter(const std::string& message) : InvalidInput(message, ExitCode::Usage)
    {
    }
};

/// The file system refused.
struct IoError : Error {
    explicit IoError(const std::string& message) : Error(ExitCode::CannotWrite, message) {}
};

/// More memory, time or voxels than allowed.
struct LimitExceeded : Error {
    explicit LimitExceeded(const std::string& message) : Error(ExitCode::Limit, message) {}
};

/// An iteration that does not converge; carries step and residual in its message.
struct NumericalError : Error {
    explicit NumericalError(const std::string& message) : Error(ExitCode::BadInput, message) {}
};

/// Somebody asked to stop.
struct Cancelled : Error {
    Cancelled() : Error(ExitCode::Interrupted, "interrupted") {}
};

/// "12.3 MB" style text for messages.
std::string bytes_text(double bytes);

/// "1.2 million" style text for counts in messages.
std::string count_text(double count);

}  // namespace sekitei
