#pragma once

#include <string_view>

#include "core/params.h"

namespace sekitei {

/// Levels of JSON that a file may have; ours have six.
inline constexpr int kDeepestJson = 100;

/// Json::parse() of a file's text. Parsing has no limit of depth by itself, but writing, comparing
/// and copying what was parsed call themselves once a level: a million brackets end the program.
/// @throws Json::parse_error  not JSON, or nested too deeply; if not `allow_exceptions`, a
/// discarded
///                            value is returned instead
inline Json parse_json(std::string_view text, bool allow_exceptions = true)
{
    int depth = 0;
    bool quoted = false;
    for (std::size_t i = 0; i < text.size(); ++i) {
        const char c = text[i];
        if (quoted) {
            if (c == '\\')
                ++i;
            else if (c == '"')
                quoted = false;
        } else if (c == '"')
            quoted = true;
        else if (c == '[' || c == '{') {
            if (++depth > kDeepestJson)
                return Json::parse("nested too deeply", nullptr, allow_exceptions);
        } else if (c == ']' || c == '}')
            --depth;
    }
    return Json::parse(text, nullptr, allow_exceptions);
}

}  // namespace sekitei
