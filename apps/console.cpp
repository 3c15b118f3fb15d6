#include "apps/console.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>

#include "core/log.h"

namespace sekitei::apps {

std::atomic<bool> g_stop{false};

namespace {

std::atomic<int> g_signal{0};
std::atomic<bool> g_line_shown{false};

extern "C" void on_signal(int signal)
{
    if (g_stop.exchange(true)) ::_exit(128 + signal);
    g_signal = signal;
}

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start)
{
    return std::chrono::duration<double>(Clock::now() - start).count();
}

}  // namespace

void hold_standard_descriptors()
{
    for (int fd = STDIN_FILENO; fd <= STDERR_FILENO; ++fd)
        if (::fcntl(fd, F_GETFD) == -1)  // open() takes the lowest free number, which is this one
            ::open("/dev/null", fd == STDIN_FILENO ? O_WRONLY : O_RDONLY);
}

void install_signal_handlers()
{
    std::signal(SIGPIPE, SIG_IGN);
    std::signal(SIGXFSZ, SIG_IGN);
    struct sigaction action {};
    action.sa_handler = on_signal;
    sigaction(SIGINT, &action, nullptr);
    sigaction(SIGTERM, &action, nullptr);
}

int interrupted_exit_code()
{
    return g_signal == SIGTERM ? 128 + SIGTERM : 128 + SIGINT;
}

bool stderr_is_terminal()
{
    return ::isatty(STDERR_FILENO) == 1;
}

bool use_colour()
{
    return stderr_is_terminal() && std::getenv("NO_COLOR") == nullptr;
}

std::string duration_text(double seconds)
{
    if (seconds < 60) return fmt::format("{:.1f} s", seconds);
    const auto whole = static_cast<int>(std::lround(seconds));
    if (whole < 3600) return fmt::format("{} min {} s", whole / 60, whole % 60);
    return fmt::format("{} h {} min", whole / 3600, whole / 60 % 60);
}

void clear_progress_line()
{
    if (g_line_shown.exchange(false)) std::fputs("\r\033[K", stderr);
}

Progress console_progress(const std::string& stage)
{
    const auto start = Clock::now();
    auto last = std::make_shared<Clock::time_point>(start);
    auto listener = [start, last, stage](const std::string& step, double fraction) {
        if (!stderr_is_terminal() || log::level() < log::Level::Info) return;
        // Nothing for work under a second; then ten times a second at most.
        if (seconds_since(start) < 1 || seconds_since(*last) < 0.1) return;
        *last = Clock::now();
        const int width = 24, done = static_cast<int>(fraction * width);
        const double elapsed = seconds_since(start);
        const std::string left =
            fraction > 0.02 ? duration_text(elapsed / fraction * (1 - fraction)) + " left" : "";
        const std::string name = step.empty() ? stage : stage + ": " + step;
        std::fputs(fmt::format("\r\033[K{} [{:#<{}}{:.<{}}] {:3.0f} %  {}", name, "", done, "",
                               width - done, fraction * 100, left)
                       .c_str(),
                   stderr);
        std::fflush(stderr);
        g_line_shown = true;
    };
    return Progress(listener, &g_stop);
}

}  // namespace sekitei::apps
