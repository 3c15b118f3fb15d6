#include "core/log.h"

#include <atomic>
#include <cstdio>
#include <mutex>

namespace sekitei::log {
namespace {

std::atomic<Level> g_level{Level::Info};
std::mutex g_mutex;
std::function<void(Level, const std::string&)> g_sink;

}  // namespace

void set_level(Level level)
{
    g_level = level;
}
Level level()
{
    return g_level;
}

void set_sink(std::function<void(Level, const std::string&)> sink)
{
    const std::lock_guard lock(g_mutex);
    g_sink = std::move(sink);
}

void write(Level level, const std::string& line)
{
    const std::lock_guard lock(g_mutex);
    if (g_sink) return g_sink(level, line);
    const std::string text = (level == Level::Warning ? "warning: " : "") + line + "\n";
    std::fwrite(text.data(), 1, text.size(), stderr);
}

}  // namespace sekitei::log
