#include "core/progress.h"

#include "core/error.h"

namespace sekitei {

void Progress::check() const
{
    if (cancelled()) throw Cancelled();
}

void Progress::update(double fraction) const
{
    check();
    if (listener_ && *listener_) (*listener_)(stage_, begin_ + (end_ - begin_) * fraction);
}

Progress Progress::slice(double begin, double end) const
{
    Progress part = *this;
    part.begin_ = begin_ + (end_ - begin_) * begin;
    part.end_ = begin_ + (end_ - begin_) * end;
    return part;
}

Progress Progress::named(std::string stage) const
{
    Progress part = *this;
    part.stage_ = std::move(stage);
    return part;
}

}  // namespace sekitei
