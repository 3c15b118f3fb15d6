#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <string>

namespace sekitei {

/// How far a long computation is, and the wish to stop it. Passed down, never global.
///
/// A default-constructed Progress reports to nobody and is never cancelled. Copies and slices share
/// the same listener and the same wish.
class Progress {
public:
    using Listener = std::function<void(const std::string& stage, double fraction)>;

    Progress() = default;
    /// @param cancel  set from anywhere, a signal handler included; must outlive the Progress
    Progress(Listener listener, const std::atomic<bool>* cancel)
        : listener_(std::make_shared<Listener>(std::move(listener))), cancel_(cancel)
    {
    }

    /// Reports `fraction` in [0, 1] of this slice. Call from one thread, a few times a second or
    /// more.
    /// @throws Cancelled  once somebody asked to stop
    void update(double fraction) const;

    /// For loops on many threads: throws Cancelled like update(), reports nothing.
    void check() const;

    bool cancelled() const { return cancel_ && cancel_->load(std::memory_order_relaxed); }

    /// The part [begin, end] of this progress, for one step of a larger job.
    Progress slice(double begin, double end) const;
    /// The same progress under another name.
    Progress named(std::string stage) const;

private:
    std::shared_ptr<Listener> listener_;
    const std::atomic<bool>* cancel_ = nullptr;
    std::string stage_;
    double begin_ = 0, end_ = 1;
};

}  // namespace sekitei
