define internal void @body(ptr %q, i64 %q.stride, ptr %qd, i64 %qd.stride, ptr %tau, i64 %tau.stride, ptr %free, i64 %free.stride, ptr %out, i64 %out.stride) {
entry:
  %v1 = load <4 x double>, ptr %q, align 8
  %v2 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v1, <4 x double> splat (double 0x3FE45F306DC9C883), <4 x double> splat (double 0x4338000000000000))
  %v3 = fsub <4 x double> %v2, splat (double 0x4338000000000000)
  %v4 = getelementptr i8, ptr %q, i64 %q.stride
  %v5 = load <4 x double>, ptr %v4, align 8
  %v6 = fsub <4 x double> splat (double 0xC004000000000000), %v5
  %v7 = fneg <4 x double> %v3
  %v8 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v7, <4 x double> splat (double 0x3FF921FB54440000), <4 x double> %v1)
  %v9 = fneg <4 x double> %v5
  %v10 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v9, <4 x double> %v6, <4 x double> splat (double 0x3FF9000000000000))
  %v11 = fadd <4 x double> %v3, splat (double 0x3FF0000000000000)
  %v12 = fadd <4 x double> %v3, splat (double 0x4348000000000000)
  %v13 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v7, <4 x double> splat (double 0x3D868C234C4C0000), <4 x double> %v8)
  %v14 = fsub <4 x double> %v12, splat (double 0x4348000000000000)
  %v15 = fadd <4 x double> splat (double 0x4004000000000000), %v10
  %v16 = fsub <4 x double> %v13, %v8
  %v17 = fmul <4 x double> %v13, splat (double 0x3FE0000000000000)
  %v18 = fsub <4 x double> %v14, %v3
  %v19 = fmul <4 x double> %v17, %v13
  %v20 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v3, <4 x double> splat (double 0x3D868C234C4C0000), <4 x double> %v16)
  %v21 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v3, <4 x double> splat (double 0x3B298A2E03707345), <4 x double> %v20)
  %v22 = fneg <4 x double> %v19
  %v23 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v22, <4 x double> splat (double 0x3E45D8B559CDAE9C), <4 x double> splat (double 0x3EAAE5E4B83F3EFB))
  %v24 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v22, <4 x double> splat (double 0x3E18FA684A042C88), <4 x double> splat (double 0x3E81EE9DBCF1CA8B))
  %v25 = fdiv <4 x double> splat (double 0x3FF0000000000000), %v15
  %v26 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v23, <4 x double> %v19, <4 x double> splat (double 0xBF071DE35552B59E))
  %v27 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v24, <4 x double> %v19, <4 x double> splat (double 0xBEE27E4F7F19164F))
  %v28 = fmul <4 x double> %v13, %v19
  %v29 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v26, <4 x double> %v19, <4 x double> splat (double 0x3F5A01A019BE9217))
  %v30 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v27, <4 x double> %v19, <4 x double> splat (double 0x3F3A01A019C8F255))
  %v31 = fadd <4 x double> %v11, splat (double 0x4348000000000000)
  %v32 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v29, <4 x double> %v19, <4 x double> splat (double 0xBFA111111110F730))
  %v33 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v30, <4 x double> %v19, <4 x double> splat (double 0xBF86C16C16C15015))
  %v34 = fsub <4 x double> %v31, splat (double 0x4348000000000000)
  %v35 = fsub <4 x double> %v11, %v34
  %v36 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v32, <4 x double> %v19, <4 x double> splat (double 0x3FD5555555555548))
  %v37 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v28, <4 x double> %v36, <4 x double> %v21)
  %v38 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v33, <4 x double> %v19, <4 x double> splat (double 0x3FC555555555554B))
  %v39 = fsub <4 x double> %v13, %v37
  %v40 = fmul <4 x double> %v19, %v38
  %v41 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v22, <4 x double> %v40, <4 x double> %v19)
  %v42 = load <4 x double>, ptr %free, align 8
  %v43 = fcmp ogt <4 x double> %v42, splat (double 0x0000000000000000)
  %v44 = select <4 x i1> %v43, <4 x double> %v25, <4 x double> splat (double 0x0000000000000000)
  %v45 = fmul <4 x double> %v39, %v18
  %v46 = fmul <4 x double> %v39, %v35
  %v47 = fsub <4 x double> splat (double 0x3FF0000000000000), %v41
  %v48 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v47, <4 x double> %v35, <4 x double> %v45)
  %v49 = fneg <4 x double> %v47
  %v50 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v49, <4 x double> %v18, <4 x double> %v46)
  %v51 = load <4 x double>, ptr %qd, align 8
  %v52 = getelementptr i8, ptr %qd, i64 %qd.stride
  %v53 = load <4 x double>, ptr %v52, align 8
  %v54 = fmul <4 x double> %v51, %v53
  %v55 = fmul <4 x double> %v51, %v51
  %v56 = fmul <4 x double> %v48, splat (double 0x4020000000000000)
  %v57 = getelementptr i8, ptr %free, i64 %free.stride
  %v58 = load <4 x double>, ptr %v57, align 8
  %v59 = fcmp ogt <4 x double> %v58, splat (double 0x0000000000000000)
  %v60 = select <4 x i1> %v59, <4 x double> splat (double 0x3FF0000000000000), <4 x double> splat (double 0x0000000000000000)
  %v61 = fmul <4 x double> %v55, %v5
  %v62 = fneg <4 x double> %v50
  %v63 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v62, <4 x double> splat (double 0x4020000000000000), <4 x double> %v61)
  %v64 = call <4 x double> @llvm.fma.v4f64(<4 x double> splat (double 0x4000000000000000), <4 x double> %v54, <4 x double> %v56)
  %v65 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v55, <4 x double> splat (double 0x3FF4000000000000), <4 x double> %v63)
  %v66 = fmul <4 x double> %v5, %v64
  %v67 = call <4 x double> @llvm.fma.v4f64(<4 x double> splat (double 0x3FF4000000000000), <4 x double> %v64, <4 x double> %v66)
  %v68 = getelementptr i8, ptr %tau, i64 %tau.stride
  %v69 = load <4 x double>, ptr %v68, align 8
  %v70 = fadd <4 x double> %v69, %v65
  %v71 = fadd <4 x double> %v56, %v67
  %v72 = fmul <4 x double> %v70, %v60
  %v73 = load <4 x double>, ptr %tau, align 8
  %v74 = fsub <4 x double> %v73, %v71
  %v75 = fcmp ogt <4 x double> %v58, splat (double 0x0000000000000000)
  %v76 = select <4 x i1> %v75, <4 x double> %v72, <4 x double> splat (double 0x0000000000000000)
  %v77 = fmul <4 x double> %v74, %v44
  %v78 = fcmp ogt <4 x double> %v42, splat (double 0x0000000000000000)
  %v79 = select <4 x i1> %v78, <4 x double> %v77, <4 x double> splat (double 0x0000000000000000)
  store <4 x double> %v79, ptr %out, align 8
  %v80 = getelementptr i8, ptr %out, i64 %out.stride
  store <4 x double> %v76, ptr %v80, align 8
  ret void
}

define internal void @evaluate(ptr %q, i64 %q.stride, ptr %qd, i64 %qd.stride, ptr %tau, i64 %tau.stride, ptr %free, i64 %free.stride, ptr %out, i64 %out.stride) {
entry:
  %a1 = alloca [2 x <4 x double>], align 64
  %v2 = load <4 x double>, ptr %q, align 8
  %v3 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v2, <4 x double> %v2, <4 x double> splat (double 0x0000000000000000))
  %v4 = fcmp ugt <4 x double> %v3, splat (double 0x4202A05F20000000)
  %v5 = call i1 @llvm.vector.reduce.or.v4i1(<4 x i1> %v4)
  br i1 %v5, label %then6, label %after7, !prof !0
then6:
  %v8 = load <4 x double>, ptr %q, align 8
  store <4 x double> %v8, ptr %a1, align 8
  call void @wrap_row(ptr %a1)
  %v9 = getelementptr i8, ptr %q, i64 %q.stride
  %v10 = load <4 x double>, ptr %v9, align 8
  %v11 = getelementptr i8, ptr %a1, i64 32
  store <4 x double> %v10, ptr %v11, align 8
  br label %after7
after7:
  %v12 = phi ptr [ %a1, %then6 ], [ %q, %entry ]
  %v13 = phi i64 [ 32, %then6 ], [ %q.stride, %entry ]
  call void @body(ptr %v12, i64 %v13, ptr %qd, i64 %qd.stride, ptr %tau, i64 %tau.stride, ptr %free, i64 %free.stride, ptr %out, i64 %out.stride)
  ret void
}

define internal void @wrap_row(ptr %row) cold noinline {
entry:
  br label %loop1
loop1:
  %v2 = phi i64 [ 0, %entry ], [ %v10, %after8 ]
  %v3 = getelementptr double, ptr %row, i64 %v2
  %v4 = load double, ptr %v3
  %v5 = call double @llvm.fabs.f64(double %v4)
  %v6 = fcmp ogt double %v5, 0x40F86A0000000000
  br i1 %v6, label %then7, label %after8
then7:
  %v9 = call double @wrap_angle(double %v4)
  store double %v9, ptr %v3
  br label %after8
after8:
  %v10 = add i64 %v2, 1
  %v11 = icmp ult i64 %v10, 4
  br i1 %v11, label %loop1, label %done12
done12:
  ret void
}

define i64 @rows(i64 %count, ptr %table) {
entry:
  %a31 = alloca [2 x <4 x double>], align 64
  %a32 = alloca [2 x <4 x double>], align 64
  %a33 = alloca [2 x <4 x double>], align 64
  %a34 = alloca [2 x <4 x double>], align 64
  %a35 = alloca [2 x <4 x double>], align 64
  %v1 = getelementptr i64, ptr %table, i64 0
  %v2 = getelementptr i64, ptr %table, i64 1
  %v3 = getelementptr i64, ptr %table, i64 2
  %v4 = load ptr, ptr %v1
  %v5 = load i64, ptr %v2
  %v6 = load i64, ptr %v3
  %v7 = getelementptr i64, ptr %table, i64 3
  %v8 = getelementptr i64, ptr %table, i64 4
  %v9 = getelementptr i64, ptr %table, i64 5
  %v10 = load ptr, ptr %v7
  %v11 = load i64, ptr %v8
  %v12 = load i64, ptr %v9
  %v13 = getelementptr i64, ptr %table, i64 6
  %v14 = getelementptr i64, ptr %table, i64 7
  %v15 = getelementptr i64, ptr %table, i64 8
  %v16 = load ptr, ptr %v13
  %v17 = load i64, ptr %v14
  %v18 = load i64, ptr %v15
  %v19 = getelementptr i64, ptr %table, i64 9
  %v20 = getelementptr i64, ptr %table, i64 10
  %v21 = getelementptr i64, ptr %table, i64 11
  %v22 = load ptr, ptr %v19
  %v23 = load i64, ptr %v20
  %v24 = load i64, ptr %v21
  %v25 = getelementptr i64, ptr %table, i64 12
  %v26 = getelementptr i64, ptr %table, i64 13
  %v27 = getelementptr i64, ptr %table, i64 14
  %v28 = load ptr, ptr %v25
  %v29 = load i64, ptr %v26
  %v30 = load i64, ptr %v27
  %v36 = icmp eq i64 %v5, 8
  %v37 = icmp eq i64 %v11, 8
  %v38 = icmp eq i64 %v17, 8
  %v39 = icmp eq i64 %v23, 8
  %v40 = icmp eq i64 %v29, 8
  %v41 = and i1 %v36, %v37
  %v42 = and i1 %v41, %v38
  %v43 = and i1 %v42, %v39
  %v44 = and i1 %v43, %v40
  %v45 = sub i64 %count, 1
  br label %loop46
loop46:
  %v47 = phi i64 [ 0, %entry ], [ %v109, %after107 ]
  %v48 = phi <4 x double> [ splat (double 0x3FF0000000000000), %entry ], [ %v105, %after107 ]
  %v49 = add i64 %v47, 3
  %v50 = icmp ule i64 %v49, %v45
  %v51 = and i1 %v44, %v50
  %v52 = xor i1 %v51, true
  %v53 = mul i64 %v47, %v5
  %v54 = getelementptr i8, ptr %v4, i64 %v53
  %v55 = mul i64 %v47, %v11
  %v56 = getelementptr i8, ptr %v10, i64 %v55
  %v57 = mul i64 %v47, %v17
  %v58 = getelementptr i8, ptr %v16, i64 %v57
  %v59 = mul i64 %v47, %v23
  %v60 = getelementptr i8, ptr %v22, i64 %v59
  %v61 = mul i64 %v47, %v29
  %v62 = getelementptr i8, ptr %v28, i64 %v61
  br i1 %v52, label %then63, label %after64
then63:
  %v65 = and i1 %v36, %v50
  %v66 = select i1 %v65, ptr %v54, ptr %a31
  %v67 = select i1 %v65, i64 %v6, i64 32
  call void @copy_in(i1 %v65, ptr %a31, ptr %v4, i64 %v5, i64 %v6, i64 %v47, i64 %v45, i1 %v50, i64 2)
  %v68 = and i1 %v37, %v50
  %v69 = select i1 %v68, ptr %v56, ptr %a32
  %v70 = select i1 %v68, i64 %v12, i64 32
  call void @copy_in(i1 %v68, ptr %a32, ptr %v10, i64 %v11, i64 %v12, i64 %v47, i64 %v45, i1 %v50, i64 2)
  %v71 = and i1 %v38, %v50
  %v72 = select i1 %v71, ptr %v58, ptr %a33
  %v73 = select i1 %v71, i64 %v18, i64 32
  call void @copy_in(i1 %v71, ptr %a33, ptr %v16, i64 %v17, i64 %v18, i64 %v47, i64 %v45, i1 %v50, i64 2)
  %v74 = and i1 %v39, %v50
  %v75 = select i1 %v74, ptr %v60, ptr %a34
  %v76 = select i1 %v74, i64 %v24, i64 32
  call void @copy_in(i1 %v74, ptr %a34, ptr %v22, i64 %v23, i64 %v24, i64 %v47, i64 %v45, i1 %v50, i64 2)
  %v77 = and i1 %v40, %v50
  %v78 = select i1 %v77, ptr %v62, ptr %a35
  %v79 = select i1 %v77, i64 %v30, i64 32
  br label %after64
after64:
  %v80 = phi ptr [ %v66, %then63 ], [ %v54, %loop46 ]
  %v81 = phi i64 [ %v67, %then63 ], [ %v6, %loop46 ]
  %v82 = phi ptr [ %v69, %then63 ], [ %v56, %loop46 ]
  %v83 = phi i64 [ %v70, %then63 ], [ %v12, %loop46 ]
  %v84 = phi ptr [ %v72, %then63 ], [ %v58, %loop46 ]
  %v85 = phi i64 [ %v73, %then63 ], [ %v18, %loop46 ]
  %v86 = phi ptr [ %v75, %then63 ], [ %v60, %loop46 ]
  %v87 = phi i64 [ %v76, %then63 ], [ %v24, %loop46 ]
  %v88 = phi ptr [ %v78, %then63 ], [ %v62, %loop46 ]
  %v89 = phi i64 [ %v79, %then63 ], [ %v30, %loop46 ]
  %v90 = load <4 x double>, ptr %v80, align 8
  %v91 = getelementptr i8, ptr %v80, i64 %v81
  %v92 = load <4 x double>, ptr %v91, align 8
  %v93 = load <4 x double>, ptr %v82, align 8
  %v94 = getelementptr i8, ptr %v82, i64 %v83
  %v95 = load <4 x double>, ptr %v94, align 8
  %v96 = load <4 x double>, ptr %v84, align 8
  %v97 = getelementptr i8, ptr %v84, i64 %v85
  %v98 = load <4 x double>, ptr %v97, align 8
  %v99 = load <4 x double>, ptr %v86, align 8
  %v100 = getelementptr i8, ptr %v86, i64 %v87
  %v101 = load <4 x double>, ptr %v100, align 8
  %v102 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v90, <4 x double> %v92, <4 x double> %v48)
  %v103 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v93, <4 x double> %v95, <4 x double> %v102)
  %v104 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v96, <4 x double> %v98, <4 x double> %v103)
  %v105 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v99, <4 x double> %v101, <4 x double> %v104)
  call void @evaluate(ptr %v80, i64 %v81, ptr %v82, i64 %v83, ptr %v84, i64 %v85, ptr %v86, i64 %v87, ptr %v88, i64 %v89)
  br i1 %v52, label %then106, label %after107
then106:
  %v108 = and i1 %v40, %v50
  call void @copy_out(i1 %v108, ptr %a35, ptr %v28, i64 %v29, i64 %v30, i64 %v47, i64 %v45, i1 %v50, i64 2)
  br label %after107
after107:
  %v109 = add i64 %v47, 4
  %v110 = icmp ult i64 %v109, %count
  br i1 %v110, label %loop46, label %done111
done111:
  %v112 = fsub <4 x double> %v105, %v105
  %v113 = fcmp uno <4 x double> %v112, %v112
  %v114 = call i1 @llvm.vector.reduce.or.v4i1(<4 x i1> %v113)
  %v115 = zext i1 %v114 to i64
  ret i64 %v115
}

define internal void @copy_in(i1 %direct, ptr %buffer, ptr %base, i64 %row, i64 %column, i64 %b, i64 %last, i1 %whole, i64 %size) {
entry:
  br i1 %direct, label %then1, label %after2
then1:
  ret void
after2:
  br i1 %whole, label %then3, label %after4
then3:
  %v5 = mul i64 %b, %row
  %v6 = getelementptr i8, ptr %base, i64 %v5
  %v7 = icmp eq i64 %column, 8
  %v8 = icmp uge i64 %size, 2
  %v9 = and i1 %v7, %v8
  br i1 %v9, label %then10, label %after11
then10:
  %v12 = sub i64 %size, 2
  br label %loop13
loop13:
  %v14 = phi i64 [ 0, %then10 ], [ %v35, %loop13 ]
  %v15 = call i64 @llvm.umin.i64(i64 %v14, i64 %v12)
  %v16 = getelementptr double, ptr %v6, i64 %v15
  %v17 = getelementptr <4 x double>, ptr %buffer, i64 %v15
  %v18 = mul i64 %row, 0
  %v19 = getelementptr i8, ptr %v16, i64 %v18
  %v20 = getelementptr i8, ptr %v16, i64 %row
  %v21 = mul i64 %row, 2
  %v22 = getelementptr i8, ptr %v16, i64 %v21
  %v23 = mul i64 %row, 3
  %v24 = getelementptr i8, ptr %v16, i64 %v23
  %v25 = getelementptr <4 x double>, ptr %v17, i64 0
  %v26 = getelementptr <4 x double>, ptr %v17, i64 1
  %v27 = load <2 x double>, ptr %v19, align 8
  %v28 = load <2 x double>, ptr %v20, align 8
  %v29 = load <2 x double>, ptr %v22, align 8
  %v30 = load <2 x double>, ptr %v24, align 8
  %v31 = shufflevector <2 x double> %v27, <2 x double> %v29, <4 x i32> <i32 0, i32 1, i32 2, i32 3>
  %v32 = shufflevector <2 x double> %v28, <2 x double> %v30, <4 x i32> <i32 0, i32 1, i32 2, i32 3>
  %v33 = shufflevector <4 x double> %v31, <4 x double> %v32, <4 x i32> <i32 0, i32 4, i32 2, i32 6>
  %v34 = shufflevector <4 x double> %v31, <4 x double> %v32, <4 x i32> <i32 1, i32 5, i32 3, i32 7>
  store <4 x double> %v33, ptr %v25, align 8
  store <4 x double> %v34, ptr %v26, align 8
  %v35 = add i64 %v14, 2
  %v36 = icmp ult i64 %v35, %size
  br i1 %v36, label %loop13, label %done37
done37:
  ret void
after11:
  %v38 = insertelement <4 x i64> poison, i64 %row, i64 0
  %v39 = shufflevector <4 x i64> %v38, <4 x i64> poison, <4 x i32> zeroinitializer
  %v40 = mul <4 x i64> %v39, <i64 0, i64 1, i64 2, i64 3>
  br label %loop41
loop41:
  %v42 = phi i64 [ 0, %after11 ], [ %v48, %loop41 ]
  %v43 = mul i64 %v42, %column
  %v44 = getelementptr i8, ptr %v6, i64 %v43
  %v45 = getelementptr i8, ptr %v44, <4 x i64> %v40
  %v46 = getelementptr <4 x double>, ptr %buffer, i64 %v42
  %v47 = call <4 x double> @llvm.masked.gather.v4f64.v4p0(<4 x ptr> align 8 %v45, <4 x i1> splat (i1 true), <4 x double> poison)
  store <4 x double> %v47, ptr %v46, align 8
  %v48 = add i64 %v42, 1
  %v49 = icmp ult i64 %v48, %size
  br i1 %v49, label %loop41, label %done50
done50:
  ret void
after4:
  call void @copy_in_tail(i1 %direct, ptr %buffer, ptr %base, i64 %row, i64 %column, i64 %b, i64 %last, i1 %whole, i64 %size)
  ret void
}

define internal void @copy_in_tail(i1 %direct, ptr %buffer, ptr %base, i64 %row, i64 %column, i64 %b, i64 %last, i1 %whole, i64 %size) {
entry:
  br label %loop1
loop1:
  %v2 = phi i64 [ 0, %entry ], [ %v18, %done17 ]
  %v3 = add i64 %b, %v2
  %v4 = call i64 @llvm.umin.i64(i64 %v3, i64 %last)
  %v5 = mul i64 %v4, %row
  %v6 = getelementptr i8, ptr %base, i64 %v5
  br label %loop7
loop7:
  %v8 = phi i64 [ 0, %loop1 ], [ %v15, %loop7 ]
  %v9 = mul i64 %v8, %column
  %v10 = getelementptr i8, ptr %v6, i64 %v9
  %v11 = mul i64 %v8, 4
  %v12 = add i64 %v11, %v2
  %v13 = getelementptr double, ptr %buffer, i64 %v12
  %v14 = load double, ptr %v10, align 8
  store double %v14, ptr %v13, align 8
  %v15 = add i64 %v8, 1
  %v16 = icmp ult i64 %v15, %size
  br i1 %v16, label %loop7, label %done17
done17:
  %v18 = add i64 %v2, 1
  %v19 = icmp ult i64 %v18, 4
  br i1 %v19, label %loop1, label %done20
done20:
  ret void
}

define internal void @copy_out(i1 %direct, ptr %buffer, ptr %base, i64 %row, i64 %column, i64 %b, i64 %last, i1 %whole, i64 %size) {
entry:
  br i1 %direct, label %then1, label %after2
then1:
  ret void
after2:
  br i1 %whole, label %then3, label %after4
then3:
  %v5 = mul i64 %b, %row
  %v6 = getelementptr i8, ptr %base, i64 %v5
  %v7 = icmp eq i64 %column, 8
  %v8 = icmp uge i64 %size, 2
  %v9 = and i1 %v7, %v8
  br i1 %v9, label %then10, label %after11
then10:
  %v12 = sub i64 %size, 2
  br label %loop13
loop13:
  %v14 = phi i64 [ 0, %then10 ], [ %v35, %loop13 ]
  %v15 = call i64 @llvm.umin.i64(i64 %v14, i64 %v12)
  %v16 = getelementptr double, ptr %v6, i64 %v15
  %v17 = getelementptr <4 x double>, ptr %buffer, i64 %v15
  %v18 = mul i64 %row, 0
  %v19 = getelementptr i8, ptr %v16, i64 %v18
  %v20 = getelementptr i8, ptr %v16, i64 %row
  %v21 = mul i64 %row, 2
  %v22 = getelementptr i8, ptr %v16, i64 %v21
  %v23 = mul i64 %row, 3
  %v24 = getelementptr i8, ptr %v16, i64 %v23
  %v25 = getelementptr <4 x double>, ptr %v17, i64 0
  %v26 = getelementptr <4 x double>, ptr %v17, i64 1
  %v27 = load <4 x double>, ptr %v25, align 8
  %v28 = load <4 x double>, ptr %v26, align 8
  %v29 = shufflevector <4 x double> %v27, <4 x double> %v28, <4 x i32> <i32 0, i32 4, i32 2, i32 6>
  %v30 = shufflevector <4 x double> %v27, <4 x double> %v28, <4 x i32> <i32 1, i32 5, i32 3, i32 7>
  %v31 = shufflevector <4 x double> %v29, <4 x double> poison, <2 x i32> <i32 0, i32 1>
  store <2 x double> %v31, ptr %v19, align 8
  %v32 = shufflevector <4 x double> %v30, <4 x double> poison, <2 x i32> <i32 0, i32 1>
  store <2 x double> %v32, ptr %v20, align 8
  %v33 = shufflevector <4 x double> %v29, <4 x double> poison, <2 x i32> <i32 2, i32 3>
  store <2 x double> %v33, ptr %v22, align 8
  %v34 = shufflevector <4 x double> %v30, <4 x double> poison, <2 x i32> <i32 2, i32 3>
  store <2 x double> %v34, ptr %v24, align 8
  %v35 = add i64 %v14, 2
  %v36 = icmp ult i64 %v35, %size
  br i1 %v36, label %loop13, label %done37
done37:
  ret void
after11:
  %v38 = insertelement <4 x i64> poison, i64 %row, i64 0
  %v39 = shufflevector <4 x i64> %v38, <4 x i64> poison, <4 x i32> zeroinitializer
  %v40 = mul <4 x i64> %v39, <i64 0, i64 1, i64 2, i64 3>
  br label %loop41
loop41:
  %v42 = phi i64 [ 0, %after11 ], [ %v48, %loop41 ]
  %v43 = mul i64 %v42, %column
  %v44 = getelementptr i8, ptr %v6, i64 %v43
  %v45 = getelementptr i8, ptr %v44, <4 x i64> %v40
  %v46 = getelementptr <4 x double>, ptr %buffer, i64 %v42
  %v47 = load <4 x double>, ptr %v46, align 8
  call void @llvm.masked.scatter.v4f64.v4p0(<4 x double> %v47, <4 x ptr> align 8 %v45, <4 x i1> splat (i1 true))
  %v48 = add i64 %v42, 1
  %v49 = icmp ult i64 %v48, %size
  br i1 %v49, label %loop41, label %done50
done50:
  ret void
after4:
  call void @copy_out_tail(i1 %direct, ptr %buffer, ptr %base, i64 %row, i64 %column, i64 %b, i64 %last, i1 %whole, i64 %size)
  ret void
}

define internal void @copy_out_tail(i1 %direct, ptr %buffer, ptr %base, i64 %row, i64 %column, i64 %b, i64 %last, i1 %whole, i64 %size) {
entry:
  br label %loop1
loop1:
  %v2 = phi i64 [ 0, %entry ], [ %v18, %done17 ]
  %v3 = add i64 %b, %v2
  %v4 = call i64 @llvm.umin.i64(i64 %v3, i64 %last)
  %v5 = mul i64 %v4, %row
  %v6 = getelementptr i8, ptr %base, i64 %v5
  br label %loop7
loop7:
  %v8 = phi i64 [ 0, %loop1 ], [ %v15, %loop7 ]
  %v9 = mul i64 %v8, %column
  %v10 = getelementptr i8, ptr %v6, i64 %v9
  %v11 = mul i64 %v8, 4
  %v12 = add i64 %v11, %v2
  %v13 = getelementptr double, ptr %buffer, i64 %v12
  %v14 = load double, ptr %v13, align 8
  store double %v14, ptr %v10, align 8
  %v15 = add i64 %v8, 1
  %v16 = icmp ult i64 %v15, %size
  br i1 %v16, label %loop7, label %done17
done17:
  %v18 = add i64 %v2, 1
  %v19 = icmp ult i64 %v18, 4
  br i1 %v19, label %loop1, label %done20
done20:
  ret void
}

define internal void @copy_columns(i1 %wanted, i64 %elements, ptr %source, i64 %source.column, ptr %target, i64 %target.column) {
entry:
  br i1 %wanted, label %then1, label %after2
then1:
  br label %loop3
loop3:
  %v4 = phi i64 [ 0, %then1 ], [ %v57, %loop3 ]
  %v5 = mul i64 %v4, %source.column
  %v6 = getelementptr i8, ptr %source, i64 %v5
  %v7 = mul i64 %v4, %target.column
  %v8 = getelementptr i8, ptr %target, i64 %v7
  %v9 = getelementptr <4 x double>, ptr %v6, i64 0
  %v10 = load <4 x double>, ptr %v9, align 8
  %v11 = getelementptr <4 x double>, ptr %v8, i64 0
  store <4 x double> %v10, ptr %v11, align 8
  %v12 = getelementptr <4 x double>, ptr %v6, i64 1
  %v13 = load <4 x double>, ptr %v12, align 8
  %v14 = getelementptr <4 x double>, ptr %v8, i64 1
  store <4 x double> %v13, ptr %v14, align 8
  %v15 = getelementptr <4 x double>, ptr %v6, i64 2
  %v16 = load <4 x double>, ptr %v15, align 8
  %v17 = getelementptr <4 x double>, ptr %v8, i64 2
  store <4 x double> %v16, ptr %v17, align 8
  %v18 = getelementptr <4 x double>, ptr %v6, i64 3
  %v19 = load <4 x double>, ptr %v18, align 8
  %v20 = getelementptr <4 x double>, ptr %v8, i64 3
  store <4 x double> %v19, ptr %v20, align 8
  %v21 = getelementptr <4 x double>, ptr %v6, i64 4
  %v22 = load <4 x double>, ptr %v21, align 8
  %v23 = getelementptr <4 x double>, ptr %v8, i64 4
  store <4 x double> %v22, ptr %v23, align 8
  %v24 = getelementptr <4 x double>, ptr %v6, i64 5
  %v25 = load <4 x double>, ptr %v24, align 8
  %v26 = getelementptr <4 x double>, ptr %v8, i64 5
  store <4 x double> %v25, ptr %v26, align 8
  %v27 = getelementptr <4 x double>, ptr %v6, i64 6
  %v28 = load <4 x double>, ptr %v27, align 8
  %v29 = getelementptr <4 x double>, ptr %v8, i64 6
  store <4 x double> %v28, ptr %v29, align 8
  %v30 = getelementptr <4 x double>, ptr %v6, i64 7
  %v31 = load <4 x double>, ptr %v30, align 8
  %v32 = getelementptr <4 x double>, ptr %v8, i64 7
  store <4 x double> %v31, ptr %v32, align 8
  %v33 = getelementptr <4 x double>, ptr %v6, i64 8
  %v34 = load <4 x double>, ptr %v33, align 8
  %v35 = getelementptr <4 x double>, ptr %v8, i64 8
  store <4 x double> %v34, ptr %v35, align 8
  %v36 = getelementptr <4 x double>, ptr %v6, i64 9
  %v37 = load <4 x double>, ptr %v36, align 8
  %v38 = getelementptr <4 x double>, ptr %v8, i64 9
  store <4 x double> %v37, ptr %v38, align 8
  %v39 = getelementptr <4 x double>, ptr %v6, i64 10
  %v40 = load <4 x double>, ptr %v39, align 8
  %v41 = getelementptr <4 x double>, ptr %v8, i64 10
  store <4 x double> %v40, ptr %v41, align 8
  %v42 = getelementptr <4 x double>, ptr %v6, i64 11
  %v43 = load <4 x double>, ptr %v42, align 8
  %v44 = getelementptr <4 x double>, ptr %v8, i64 11
  store <4 x double> %v43, ptr %v44, align 8
  %v45 = getelementptr <4 x double>, ptr %v6, i64 12
  %v46 = load <4 x double>, ptr %v45, align 8
  %v47 = getelementptr <4 x double>, ptr %v8, i64 12
  store <4 x double> %v46, ptr %v47, align 8
  %v48 = getelementptr <4 x double>, ptr %v6, i64 13
  %v49 = load <4 x double>, ptr %v48, align 8
  %v50 = getelementptr <4 x double>, ptr %v8, i64 13
  store <4 x double> %v49, ptr %v50, align 8
  %v51 = getelementptr <4 x double>, ptr %v6, i64 14
  %v52 = load <4 x double>, ptr %v51, align 8
  %v53 = getelementptr <4 x double>, ptr %v8, i64 14
  store <4 x double> %v52, ptr %v53, align 8
  %v54 = getelementptr <4 x double>, ptr %v6, i64 15
  %v55 = load <4 x double>, ptr %v54, align 8
  %v56 = getelementptr <4 x double>, ptr %v8, i64 15
  store <4 x double> %v55, ptr %v56, align 8
  %v57 = add i64 %v4, 1
  %v58 = icmp ult i64 %v57, %elements
  br i1 %v58, label %loop3, label %done59
done59:
  br label %after2
after2:
  ret void
}

define i64 @batch(i64 %count, ptr %table) {
entry:
  %a202 = alloca [15 x i64], align 64
  %a203 = alloca [32 x <4 x double>], align 64
  %a204 = alloca [32 x <4 x double>], align 64
  %a205 = alloca [32 x <4 x double>], align 64
  %a206 = alloca [32 x <4 x double>], align 64
  %a207 = alloca [32 x <4 x double>], align 64
  %v1 = getelementptr i64, ptr %table, i64 0
  %v2 = getelementptr i64, ptr %table, i64 1
  %v3 = getelementptr i64, ptr %table, i64 2
  %v4 = load ptr, ptr %v1
  %v5 = load i64, ptr %v2
  %v6 = load i64, ptr %v3
  %v7 = getelementptr i64, ptr %table, i64 3
  %v8 = getelementptr i64, ptr %table, i64 4
  %v9 = getelementptr i64, ptr %table, i64 5
  %v10 = load ptr, ptr %v7
  %v11 = load i64, ptr %v8
  %v12 = load i64, ptr %v9
  %v13 = getelementptr i64, ptr %table, i64 6
  %v14 = getelementptr i64, ptr %table, i64 7
  %v15 = getelementptr i64, ptr %table, i64 8
  %v16 = load ptr, ptr %v13
  %v17 = load i64, ptr %v14
  %v18 = load i64, ptr %v15
  %v19 = getelementptr i64, ptr %table, i64 9
  %v20 = getelementptr i64, ptr %table, i64 10
  %v21 = getelementptr i64, ptr %table, i64 11
  %v22 = load ptr, ptr %v19
  %v23 = load i64, ptr %v20
  %v24 = load i64, ptr %v21
  %v25 = getelementptr i64, ptr %table, i64 12
  %v26 = getelementptr i64, ptr %table, i64 13
  %v27 = getelementptr i64, ptr %table, i64 14
  %v28 = load ptr, ptr %v25
  %v29 = load i64, ptr %v26
  %v30 = load i64, ptr %v27
  %v31 = icmp eq i64 %v5, 8
  %v32 = icmp eq i64 %v11, 8
  %v33 = icmp eq i64 %v17, 8
  %v34 = icmp eq i64 %v23, 8
  %v35 = icmp eq i64 %v29, 8
  %v36 = sub i64 0, %v30
  %v37 = and i64 %v30, %v36
  %v38 = call i64 @llvm.umin.i64(i64 %v37, i64 4096)
  %v39 = icmp uge i64 %count, 512
  %v40 = mul i64 %v38, 10
  %v41 = icmp ugt i64 %v40, 32768
  %v42 = and i1 %v31, %v32
  %v43 = and i1 %v42, %v33
  %v44 = and i1 %v43, %v34
  %v45 = and i1 %v44, %v35
  %v46 = and i1 %v45, %v39
  %v47 = and i1 %v46, %v41
  %v48 = xor i1 %v47, true
  br i1 %v48, label %then49, label %after50
then49:
  %v51 = call i64 @rows(i64 %count, ptr %table)
  ret i64 %v51
after50:
  %v52 = ptrtoint ptr %v4 to i64
  %v53 = ptrtoint ptr %v10 to i64
  %v54 = ptrtoint ptr %v16 to i64
  %v55 = ptrtoint ptr %v22 to i64
  %v56 = ptrtoint ptr %v28 to i64
  %v57 = sub i64 %v38, 1
  %v58 = sub i64 %v52, %v53
  %v59 = sub i64 %v58, -127
  %v60 = and i64 %v59, %v57
  %v61 = icmp ule i64 %v60, 254
  %v62 = select i1 %v61, i64 2, i64 0
  %v63 = add i64 2, %v62
  %v64 = select i1 %v61, i64 2, i64 0
  %v65 = add i64 2, %v64
  %v66 = sub i64 %v52, %v54
  %v67 = sub i64 %v66, -127
  %v68 = and i64 %v67, %v57
  %v69 = icmp ule i64 %v68, 254
  %v70 = select i1 %v69, i64 2, i64 0
  %v71 = add i64 %v63, %v70
  %v72 = select i1 %v69, i64 2, i64 0
  %v73 = add i64 2, %v72
  %v74 = sub i64 %v52, %v55
  %v75 = sub i64 %v74, -127
  %v76 = and i64 %v75, %v57
  %v77 = icmp ule i64 %v76, 254
  %v78 = select i1 %v77, i64 2, i64 0
  %v79 = add i64 %v71, %v78
  %v80 = select i1 %v77, i64 2, i64 0
  %v81 = add i64 2, %v80
  %v82 = sub i64 %v52, %v56
  %v83 = sub i64 %v82, -127
  %v84 = and i64 %v83, %v57
  %v85 = icmp ule i64 %v84, 254
  %v86 = select i1 %v85, i64 2, i64 0
  %v87 = add i64 %v79, %v86
  %v88 = select i1 %v85, i64 2, i64 0
  %v89 = add i64 2, %v88
  %v90 = sub i64 %v53, %v54
  %v91 = sub i64 %v90, -127
  %v92 = and i64 %v91, %v57
  %v93 = icmp ule i64 %v92, 254
  %v94 = select i1 %v93, i64 2, i64 0
  %v95 = add i64 %v65, %v94
  %v96 = select i1 %v93, i64 2, i64 0
  %v97 = add i64 %v73, %v96
  %v98 = sub i64 %v53, %v55
  %v99 = sub i64 %v98, -127
  %v100 = and i64 %v99, %v57
  %v101 = icmp ule i64 %v100, 254
  %v102 = select i1 %v101, i64 2, i64 0
  %v103 = add i64 %v95, %v102
  %v104 = select i1 %v101, i64 2, i64 0
  %v105 = add i64 %v81, %v104
  %v106 = sub i64 %v53, %v56
  %v107 = sub i64 %v106, -127
  %v108 = and i64 %v107, %v57
  %v109 = icmp ule i64 %v108, 254
  %v110 = select i1 %v109, i64 2, i64 0
  %v111 = add i64 %v103, %v110
  %v112 = select i1 %v109, i64 2, i64 0
  %v113 = add i64 %v89, %v112
  %v114 = sub i64 %v54, %v55
  %v115 = sub i64 %v114, -127
  %v116 = and i64 %v115, %v57
  %v117 = icmp ule i64 %v116, 254
  %v118 = select i1 %v117, i64 2, i64 0
  %v119 = add i64 %v97, %v118
  %v120 = select i1 %v117, i64 2, i64 0
  %v121 = add i64 %v105, %v120
  %v122 = sub i64 %v54, %v56
  %v123 = sub i64 %v122, -127
  %v124 = and i64 %v123, %v57
  %v125 = icmp ule i64 %v124, 254
  %v126 = select i1 %v125, i64 2, i64 0
  %v127 = add i64 %v119, %v126
  %v128 = select i1 %v125, i64 2, i64 0
  %v129 = add i64 %v113, %v128
  %v130 = sub i64 %v55, %v56
  %v131 = sub i64 %v130, -127
  %v132 = and i64 %v131, %v57
  %v133 = icmp ule i64 %v132, 254
  %v134 = select i1 %v133, i64 2, i64 0
  %v135 = add i64 %v121, %v134
  %v136 = select i1 %v133, i64 2, i64 0
  %v137 = add i64 %v129, %v136
  %v138 = mul i64 %v38, %v87
  %v139 = icmp ugt i64 %v138, 32768
  %v140 = mul i64 %v38, %v111
  %v141 = icmp ugt i64 %v140, 32768
  %v142 = mul i64 %v38, %v127
  %v143 = icmp ugt i64 %v142, 32768
  %v144 = mul i64 %v38, %v135
  %v145 = icmp ugt i64 %v144, 32768
  %v146 = mul i64 %v38, %v137
  %v147 = icmp ugt i64 %v146, 32768
  %v148 = or i1 %v139, %v141
  %v149 = or i1 %v148, %v143
  %v150 = or i1 %v149, %v145
  %v151 = or i1 %v150, %v147
  %v152 = xor i1 %v151, true
  br i1 %v152, label %then153, label %after154
then153:
  %v155 = call i64 @rows(i64 %count, ptr %table)
  ret i64 %v155
after154:
  %v156 = sub i64 0, %v56
  %v157 = and i64 %v156, 63
  %v158 = udiv i64 %v157, 8
  %v159 = icmp ne i64 %v158, 0
  br i1 %v159, label %then160, label %after161
then160:
  %v162 = call i64 @rows(i64 %v158, ptr %table)
  br label %after161
after161:
  %v163 = phi i64 [ %v162, %then160 ], [ 0, %after154 ]
  %v164 = mul i64 %v158, 8
  %v165 = sub i64 %v56, %v52
  %v166 = sub i64 %v165, 1
  %v167 = and i64 %v166, %v57
  %v168 = icmp ule i64 %v167, 126
  %v169 = sub i64 %v56, %v53
  %v170 = sub i64 %v169, 1
  %v171 = and i64 %v170, %v57
  %v172 = icmp ule i64 %v171, 126
  %v173 = sub i64 %v56, %v54
  %v174 = sub i64 %v173, 1
  %v175 = and i64 %v174, %v57
  %v176 = icmp ule i64 %v175, 126
  %v177 = sub i64 %v56, %v55
  %v178 = sub i64 %v177, 1
  %v179 = and i64 %v178, %v57
  %v180 = icmp ule i64 %v179, 126
  %v181 = or i1 %v139, %v141
  %v182 = or i1 %v181, %v143
  %v183 = or i1 %v182, %v145
  %v184 = or i1 %v183, %v147
  %v185 = or i1 %v184, %v168
  %v186 = or i1 %v185, %v172
  %v187 = or i1 %v186, %v176
  %v188 = or i1 %v187, %v180
  %v189 = mul i64 %v38, 8
  %v190 = icmp ugt i64 %v189, 65536
  %v191 = and i1 %v188, %v190
  %v192 = mul i64 %v38, 6
  %v193 = icmp ugt i64 %v192, 65536
  %v194 = and i1 %v188, %v193
  %v195 = mul i64 %v38, 4
  %v196 = icmp ugt i64 %v195, 65536
  %v197 = and i1 %v188, %v196
  %v198 = mul i64 %v38, 2
  %v199 = icmp ugt i64 %v198, 65536
  %v200 = and i1 %v188, %v199
  %v201 = select i1 %v188, i64 64, i64 %count
  %v208 = getelementptr i64, ptr %a202, i64 1
  store i64 %v5, ptr %v208
  %v209 = getelementptr i64, ptr %a202, i64 4
  store i64 %v11, ptr %v209
  %v210 = getelementptr i64, ptr %a202, i64 7
  store i64 %v17, ptr %v210
  %v211 = getelementptr i64, ptr %a202, i64 10
  store i64 %v23, ptr %v211
  %v212 = getelementptr i64, ptr %a202, i64 13
  store i64 %v29, ptr %v212
  br label %loop213
loop213:
  %v214 = phi i64 [ %v158, %after161 ], [ %v256, %loop213 ]
  %v215 = phi i64 [ %v163, %after161 ], [ %v255, %loop213 ]
  %v216 = sub i64 %count, %v214
  %v217 = icmp uge i64 %v216, %v201
  %v218 = call i64 @llvm.umin.i64(i64 %v216, i64 %v201)
  %v219 = and i1 %v191, %v217
  %v220 = mul i64 %v214, %v5
  %v221 = getelementptr i8, ptr %v4, i64 %v220
  %v222 = select i1 %v219, ptr %a203, ptr %v221
  %v223 = select i1 %v219, i64 512, i64 %v6
  %v224 = getelementptr i64, ptr %a202, i64 0
  store ptr %v222, ptr %v224
  %v225 = getelementptr i64, ptr %a202, i64 2
  store i64 %v223, ptr %v225
  %v226 = and i1 %v194, %v217
  %v227 = mul i64 %v214, %v11
  %v228 = getelementptr i8, ptr %v10, i64 %v227
  %v229 = select i1 %v226, ptr %a204, ptr %v228
  %v230 = select i1 %v226, i64 512, i64 %v12
  %v231 = getelementptr i64, ptr %a202, i64 3
  store ptr %v229, ptr %v231
  %v232 = getelementptr i64, ptr %a202, i64 5
  store i64 %v230, ptr %v232
  %v233 = and i1 %v197, %v217
  %v234 = mul i64 %v214, %v17
  %v235 = getelementptr i8, ptr %v16, i64 %v234
  %v236 = select i1 %v233, ptr %a205, ptr %v235
  %v237 = select i1 %v233, i64 512, i64 %v18
  %v238 = getelementptr i64, ptr %a202, i64 6
  store ptr %v236, ptr %v238
  %v239 = getelementptr i64, ptr %a202, i64 8
  store i64 %v237, ptr %v239
  %v240 = and i1 %v200, %v217
  %v241 = mul i64 %v214, %v23
  %v242 = getelementptr i8, ptr %v22, i64 %v241
  %v243 = select i1 %v240, ptr %a206, ptr %v242
  %v244 = select i1 %v240, i64 512, i64 %v24
  %v245 = getelementptr i64, ptr %a202, i64 9
  store ptr %v243, ptr %v245
  %v246 = getelementptr i64, ptr %a202, i64 11
  store i64 %v244, ptr %v246
  %v247 = and i1 %v188, %v217
  %v248 = mul i64 %v214, %v29
  %v249 = getelementptr i8, ptr %v28, i64 %v248
  %v250 = select i1 %v247, ptr %a207, ptr %v249
  %v251 = select i1 %v247, i64 512, i64 %v30
  %v252 = getelementptr i64, ptr %a202, i64 12
  store ptr %v250, ptr %v252
  %v253 = getelementptr i64, ptr %a202, i64 14
  store i64 %v251, ptr %v253
  call void @copy_columns(i1 %v219, i64 2, ptr %v221, i64 %v6, ptr %v222, i64 %v223)
  call void @copy_columns(i1 %v226, i64 2, ptr %v228, i64 %v12, ptr %v229, i64 %v230)
  call void @copy_columns(i1 %v233, i64 2, ptr %v235, i64 %v18, ptr %v236, i64 %v237)
  call void @copy_columns(i1 %v240, i64 2, ptr %v242, i64 %v24, ptr %v243, i64 %v244)
  %v254 = call i64 @rows(i64 %v218, ptr %a202)
  call void @copy_columns(i1 %v247, i64 2, ptr %v250, i64 %v251, ptr %v249, i64 %v30)
  %v255 = or i64 %v215, %v254
  %v256 = add i64 %v214, %v201
  %v257 = icmp ult i64 %v256, %count
  br i1 %v257, label %loop213, label %done258
done258:
  ret i64 %v255
}

define internal i64 @table(ptr %args, i64 %count, ptr %table) {
entry:
  %v1 = icmp eq i64 %count, 5
  %v2 = xor i1 %v1, true
  br i1 %v2, label %then3, label %after4
then3:
  ret i64 0
after4:
  %v5 = getelementptr ptr, ptr %args, i64 0
  %v6 = load ptr, ptr %v5
  %v7 = getelementptr i8, ptr %v6, i64 8
  %v8 = load ptr, ptr %v7
  %v9 = icmp eq ptr %v8, @pfd.ndarray
  %v10 = xor i1 %v9, true
  br i1 %v10, label %then11, label %after12
then11:
  ret i64 0
after12:
  %v13 = getelementptr i8, ptr %v6, i64 56
  %v14 = load ptr, ptr %v13
  %v15 = icmp eq ptr %v14, @pfd.float64
  %v16 = xor i1 %v15, true
  br i1 %v16, label %then17, label %after18
then17:
  ret i64 0
after18:
  %v19 = getelementptr i8, ptr %v6, i64 24
  %v20 = load i32, ptr %v19
  %v21 = icmp eq i32 %v20, 2
  %v22 = xor i1 %v21, true
  br i1 %v22, label %then23, label %after24
then23:
  ret i64 0
after24:
  %v25 = getelementptr i8, ptr %v6, i64 64
  %v26 = load i32, ptr %v25
  %v27 = and i32 %v26, 256
  %v28 = icmp eq i32 %v27, 256
  %v29 = xor i1 %v28, true
  br i1 %v29, label %then30, label %after31
then30:
  ret i64 0
after31:
  %v32 = getelementptr ptr, ptr %args, i64 1
  %v33 = load ptr, ptr %v32
  %v34 = getelementptr i8, ptr %v33, i64 8
  %v35 = load ptr, ptr %v34
  %v36 = icmp eq ptr %v35, @pfd.ndarray
  %v37 = xor i1 %v36, true
  br i1 %v37, label %then38, label %after39
then38:
  ret i64 0
after39:
  %v40 = getelementptr i8, ptr %v33, i64 56
  %v41 = load ptr, ptr %v40
  %v42 = icmp eq ptr %v41, @pfd.float64
  %v43 = xor i1 %v42, true
  br i1 %v43, label %then44, label %after45
then44:
  ret i64 0
after45:
  %v46 = getelementptr i8, ptr %v33, i64 24
  %v47 = load i32, ptr %v46
  %v48 = icmp eq i32 %v47, 2
  %v49 = xor i1 %v48, true
  br i1 %v49, label %then50, label %after51
then50:
  ret i64 0
after51:
  %v52 = getelementptr i8, ptr %v33, i64 64
  %v53 = load i32, ptr %v52
  %v54 = and i32 %v53, 256
  %v55 = icmp eq i32 %v54, 256
  %v56 = xor i1 %v55, true
  br i1 %v56, label %then57, label %after58
then57:
  ret i64 0
after58:
  %v59 = getelementptr ptr, ptr %args, i64 2
  %v60 = load ptr, ptr %v59
  %v61 = getelementptr i8, ptr %v60, i64 8
  %v62 = load ptr, ptr %v61
  %v63 = icmp eq ptr %v62, @pfd.ndarray
  %v64 = xor i1 %v63, true
  br i1 %v64, label %then65, label %after66
then65:
  ret i64 0
after66:
  %v67 = getelementptr i8, ptr %v60, i64 56
  %v68 = load ptr, ptr %v67
  %v69 = icmp eq ptr %v68, @pfd.float64
  %v70 = xor i1 %v69, true
  br i1 %v70, label %then71, label %after72
then71:
  ret i64 0
after72:
  %v73 = getelementptr i8, ptr %v60, i64 24
  %v74 = load i32, ptr %v73
  %v75 = icmp eq i32 %v74, 2
  %v76 = xor i1 %v75, true
  br i1 %v76, label %then77, label %after78
then77:
  ret i64 0
after78:
  %v79 = getelementptr i8, ptr %v60, i64 64
  %v80 = load i32, ptr %v79
  %v81 = and i32 %v80, 256
  %v82 = icmp eq i32 %v81, 256
  %v83 = xor i1 %v82, true
  br i1 %v83, label %then84, label %after85
then84:
  ret i64 0
after85:
  %v86 = getelementptr ptr, ptr %args, i64 3
  %v87 = load ptr, ptr %v86
  %v88 = getelementptr i8, ptr %v87, i64 8
  %v89 = load ptr, ptr %v88
  %v90 = icmp eq ptr %v89, @pfd.ndarray
  %v91 = xor i1 %v90, true
  br i1 %v91, label %then92, label %after93
then92:
  ret i64 0
after93:
  %v94 = getelementptr i8, ptr %v87, i64 56
  %v95 = load ptr, ptr %v94
  %v96 = icmp eq ptr %v95, @pfd.float64
  %v97 = xor i1 %v96, true
  br i1 %v97, label %then98, label %after99
then98:
  ret i64 0
after99:
  %v100 = getelementptr i8, ptr %v87, i64 24
  %v101 = load i32, ptr %v100
  %v102 = icmp eq i32 %v101, 2
  %v103 = xor i1 %v102, true
  br i1 %v103, label %then104, label %after105
then104:
  ret i64 0
after105:
  %v106 = getelementptr i8, ptr %v87, i64 64
  %v107 = load i32, ptr %v106
  %v108 = and i32 %v107, 256
  %v109 = icmp eq i32 %v108, 256
  %v110 = xor i1 %v109, true
  br i1 %v110, label %then111, label %after112
then111:
  ret i64 0
after112:
  %v113 = getelementptr ptr, ptr %args, i64 4
  %v114 = load ptr, ptr %v113
  %v115 = getelementptr i8, ptr %v114, i64 8
  %v116 = load ptr, ptr %v115
  %v117 = icmp eq ptr %v116, @pfd.ndarray
  %v118 = xor i1 %v117, true
  br i1 %v118, label %then119, label %after120
then119:
  ret i64 0
after120:
  %v121 = getelementptr i8, ptr %v114, i64 56
  %v122 = load ptr, ptr %v121
  %v123 = icmp eq ptr %v122, @pfd.float64
  %v124 = xor i1 %v123, true
  br i1 %v124, label %then125, label %after126
then125:
  ret i64 0
after126:
  %v127 = getelementptr i8, ptr %v114, i64 24
  %v128 = load i32, ptr %v127
  %v129 = icmp eq i32 %v128, 2
  %v130 = xor i1 %v129, true
  br i1 %v130, label %then131, label %after132
then131:
  ret i64 0
after132:
  %v133 = getelementptr i8, ptr %v114, i64 64
  %v134 = load i32, ptr %v133
  %v135 = and i32 %v134, 1280
  %v136 = icmp eq i32 %v135, 1280
  %v137 = xor i1 %v136, true
  br i1 %v137, label %then138, label %after139
then138:
  ret i64 0
after139:
  %v140 = getelementptr i8, ptr %v6, i64 32
  %v141 = load ptr, ptr %v140
  %v142 = load i64, ptr %v141
  %v143 = getelementptr i64, ptr %v141, i64 1
  %v144 = load i64, ptr %v143
  %v145 = icmp eq i64 %v144, 2
  %v146 = icmp eq i64 %v142, %v142
  %v147 = and i1 %v145, %v146
  %v148 = xor i1 %v147, true
  br i1 %v148, label %then149, label %after150
then149:
  ret i64 0
after150:
  %v151 = getelementptr i8, ptr %v6, i64 16
  %v152 = load ptr, ptr %v151
  %v153 = getelementptr i64, ptr %table, i64 0
  store ptr %v152, ptr %v153
  %v154 = getelementptr i8, ptr %v6, i64 40
  %v155 = load ptr, ptr %v154
  %v156 = load <2 x i64>, ptr %v155, align 8
  %v157 = getelementptr i64, ptr %table, i64 1
  store <2 x i64> %v156, ptr %v157, align 8
  %v158 = getelementptr i8, ptr %v33, i64 32
  %v159 = load ptr, ptr %v158
  %v160 = load i64, ptr %v159
  %v161 = getelementptr i64, ptr %v159, i64 1
  %v162 = load i64, ptr %v161
  %v163 = icmp eq i64 %v162, 2
  %v164 = icmp eq i64 %v160, %v142
  %v165 = and i1 %v163, %v164
  %v166 = xor i1 %v165, true
  br i1 %v166, label %then167, label %after168
then167:
  ret i64 0
after168:
  %v169 = getelementptr i8, ptr %v33, i64 16
  %v170 = load ptr, ptr %v169
  %v171 = getelementptr i64, ptr %table, i64 3
  store ptr %v170, ptr %v171
  %v172 = getelementptr i8, ptr %v33, i64 40
  %v173 = load ptr, ptr %v172
  %v174 = load <2 x i64>, ptr %v173, align 8
  %v175 = getelementptr i64, ptr %table, i64 4
  store <2 x i64> %v174, ptr %v175, align 8
  %v176 = getelementptr i8, ptr %v60, i64 32
  %v177 = load ptr, ptr %v176
  %v178 = load i64, ptr %v177
  %v179 = getelementptr i64, ptr %v177, i64 1
  %v180 = load i64, ptr %v179
  %v181 = icmp eq i64 %v180, 2
  %v182 = icmp eq i64 %v178, %v142
  %v183 = and i1 %v181, %v182
  %v184 = xor i1 %v183, true
  br i1 %v184, label %then185, label %after186
then185:
  ret i64 0
after186:
  %v187 = getelementptr i8, ptr %v60, i64 16
  %v188 = load ptr, ptr %v187
  %v189 = getelementptr i64, ptr %table, i64 6
  store ptr %v188, ptr %v189
  %v190 = getelementptr i8, ptr %v60, i64 40
  %v191 = load ptr, ptr %v190
  %v192 = load <2 x i64>, ptr %v191, align 8
  %v193 = getelementptr i64, ptr %table, i64 7
  store <2 x i64> %v192, ptr %v193, align 8
  %v194 = getelementptr i8, ptr %v87, i64 32
  %v195 = load ptr, ptr %v194
  %v196 = load i64, ptr %v195
  %v197 = getelementptr i64, ptr %v195, i64 1
  %v198 = load i64, ptr %v197
  %v199 = icmp eq i64 %v198, 2
  %v200 = icmp eq i64 %v196, %v142
  %v201 = and i1 %v199, %v200
  %v202 = xor i1 %v201, true
  br i1 %v202, label %then203, label %after204
then203:
  ret i64 0
after204:
  %v205 = getelementptr i8, ptr %v87, i64 16
  %v206 = load ptr, ptr %v205
  %v207 = getelementptr i64, ptr %table, i64 9
  store ptr %v206, ptr %v207
  %v208 = getelementptr i8, ptr %v87, i64 40
  %v209 = load ptr, ptr %v208
  %v210 = load <2 x i64>, ptr %v209, align 8
  %v211 = getelementptr i64, ptr %table, i64 10
  store <2 x i64> %v210, ptr %v211, align 8
  %v212 = getelementptr i8, ptr %v114, i64 32
  %v213 = load ptr, ptr %v212
  %v214 = load i64, ptr %v213
  %v215 = getelementptr i64, ptr %v213, i64 1
  %v216 = load i64, ptr %v215
  %v217 = icmp eq i64 %v216, 2
  %v218 = icmp eq i64 %v214, %v142
  %v219 = and i1 %v217, %v218
  %v220 = xor i1 %v219, true
  br i1 %v220, label %then221, label %after222
then221:
  ret i64 0
after222:
  %v223 = getelementptr i8, ptr %v114, i64 16
  %v224 = load ptr, ptr %v223
  %v225 = getelementptr i64, ptr %table, i64 12
  store ptr %v224, ptr %v225
  %v226 = getelementptr i8, ptr %v114, i64 40
  %v227 = load ptr, ptr %v226
  %v228 = load <2 x i64>, ptr %v227, align 8
  %v229 = getelementptr i64, ptr %table, i64 13
  store <2 x i64> %v228, ptr %v229, align 8
  ret i64 %v142
}

define ptr @entry(ptr %self, ptr %args, i64 %count) {
entry:
  %a1 = alloca [15 x i64], align 64
  %v2 = call i64 @table(ptr %args, i64 %count, ptr %a1)
  %v3 = icmp eq i64 %v2, 0
  br i1 %v3, label %then4, label %after5
then4:
  call void @pfd.incref(ptr @pfd.none)
  ret ptr @pfd.none
after5:
  %v6 = call ptr @pfd.save()
  %v7 = call i64 @batch(i64 %v2, ptr %a1)
  call void @pfd.restore(ptr %v6)
  %v8 = icmp ne i64 %v7, 0
  br i1 %v8, label %then9, label %after10
then9:
  call void @pfd.incref(ptr @pfd.none)
  ret ptr @pfd.none
after10:
  %v11 = getelementptr ptr, ptr %args, i64 4
  %v12 = load ptr, ptr %v11
  call void @pfd.incref(ptr %v12)
  ret ptr %v12
}
