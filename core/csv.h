#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

/// Tables in text files, read so that every fault can be named with its place.
namespace sekitei {

/// Faults of one file, collected so that all are told at once.
class Problems {
public:
    explicit Problems(std::string file) : file_(std::move(file)) {}

    /// @param line,column  from 1; columns count characters
    void add(std::size_t line, std::size_t column, std::string text);
    bool any() const { return count_ > 0; }
    /// @throws InvalidInput  all of them, one a line as `file:line:column: text`, in order of
    /// place;
    ///                       beyond 1000, or 3 alike at one place, only their number
    void throw_if_any() const;

private:
    std::string file_;
    std::map<std::pair<std::size_t, std::size_t>, std::vector<std::string>> texts_;
    std::size_t count_ = 0;
};

/// UTF-8 of a text file. A byte-order mark is dropped. Shift_JIS (as Windows writes it) is
/// converted where its bytes hold `shift_jis_mark`; any other byte that is not UTF-8 is a problem
/// and becomes '?'.
/// @throws InvalidInput  UTF-16, or bytes that are no text at all
std::string decode_text(std::string_view bytes, const std::string& file,
                        std::string_view shift_jis_mark, Problems& problems);

struct CsvCell {
    std::string_view text;  ///< without blanks and quotes around it
    std::size_t column = 0;
};

/// Rows of a table, one a line; lines end in LF, CR LF or CR.
class CsvReader {
public:
    explicit CsvReader(std::string_view text) : rest_(text) {}

    /// The next line as it stands; false at the end.
    bool next_line(std::string_view& line);
    /// Cuts a line of text into cells; a quoted cell may hold the separator.
    static void split(std::string_view line, char separator, std::vector<CsvCell>& cells);
    std::size_t line() const { return line_; }  ///< number of the last line given, from 1

private:
    std::string_view rest_;
    std::size_t line_ = 0;
};

/// The whole text as a finite number in decimal or scientific form; nothing where it is none.
std::optional<double> number_of(std::string_view text);

/// Text of a file as a message shows it: in quotes, without control characters, cut where long.
std::string quoted(std::string_view text);

}  // namespace sekitei
