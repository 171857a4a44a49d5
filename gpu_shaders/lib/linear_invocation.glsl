// A dispatch of many groups is folded into rows, because one dimension of a dispatch has a limit.
int linear_group() {
    return int(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x);
}

int linear_invocation() {
    return linear_group() * int(gl_WorkGroupSize.x) + int(gl_LocalInvocationID.x);
}
