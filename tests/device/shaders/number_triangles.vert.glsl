void main() {
    vec4 position = clip_from_object * vec4(position_os, 1.0);
    instance_number = first_instance + gl_InstanceID;
    gl_Position = position + position.w * offsets[instance_number];
}
