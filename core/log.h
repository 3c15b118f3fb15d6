#pragma once

#include <fmt/format.h>

#include <functional>
#include <string>

/// Words for people. They go to standard error through one sink, which apps/ may replace.
namespace sekitei::log {

enum class Level { Quiet, Warning, Info, Detail };

/// What is shown: warnings and info by default.
void set_level(Level level);
Level level();

/// Replaces the sink (default: standard error). Empty restores the default.
void set_sink(std::function<void(Level, const std::string&)> sink);

void write(Level level, const std::string& line);

template <class... Args>
void warning(fmt::format_string<Args...> format, Args&&... args)
{
    if (level() >= Level::Warning)
        write(Level::Warning, fmt::format(format, std::forward<Args>(args)...));
}

template <class... Args>
void info(fmt::format_string<Args...> format, Args&&... args)
{
    if (level() >= Level::Info)
        write(Level::Info, fmt::format(format, std::forward<Args>(args)...));
}

template <class... Args>
void detail(fmt::format_string<Args...> format, Args&&... args)
{
    if (level() >= Level::Detail)
        write(Level::Detail, fmt::format(format, std::forward<Args>(args)...));
}

}  // namespace sekitei::log
