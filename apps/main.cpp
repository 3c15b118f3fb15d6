#include "apps/cli.h"

int main(int argc, char** argv)
{
    return sekitei::apps::run_command_line(argc, argv);
}
